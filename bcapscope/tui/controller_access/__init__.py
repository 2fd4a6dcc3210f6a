"""How the Tester uses a `ControllerSession` to talk to the controller. This package contains no widgets."""
