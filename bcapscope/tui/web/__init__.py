"""The screen in a browser: HTTP server, access check, one process per viewer."""
