"""The Tester's connection to a controller, without widgets."""
