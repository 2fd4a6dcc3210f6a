"""The widgets of the Tester's screen: one a module, which posts messages and never reaches into another."""
