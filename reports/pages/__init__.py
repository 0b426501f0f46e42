"""Pages in HTML and Markdown, made of charts and texts."""
