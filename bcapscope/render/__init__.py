"""Renderers that return text, trees, hex dumps, tables, JSON, CSV and HTML. They do not print."""
