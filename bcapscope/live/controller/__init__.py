"""The Tester's session with a controller, without a user interface."""
