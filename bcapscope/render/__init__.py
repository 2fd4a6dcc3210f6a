"""Output as text, trees, hex dumps, tables, JSON, CSV and HTML; strings and bytes only."""
