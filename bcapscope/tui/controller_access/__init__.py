"""What stands between the widgets of the Tester and the client: no widget here, and nothing that draws."""
