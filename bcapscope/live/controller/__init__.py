"""The session with a controller that the user tests: connect, call, arm, halt, recover. It shows nothing."""
