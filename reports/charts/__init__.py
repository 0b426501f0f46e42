"""Charts as Vega-Lite specifications, made from records."""
