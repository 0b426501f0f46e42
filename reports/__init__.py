"""Pages, charts and tables, made from stored records alone."""
