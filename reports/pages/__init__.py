"""Pages (HTML and Markdown), made from a store alone."""
