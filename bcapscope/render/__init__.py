"""Words: lines, trees, hexdumps, tables, JSON and CSV, as strings and bytes only."""
