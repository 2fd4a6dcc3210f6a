"""Parts of the proxy screen."""
