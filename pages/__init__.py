"""Parts of HTML pages: plots, tables, templates."""
