"""What the screen of a proxy consists of."""
