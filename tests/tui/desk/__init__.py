"""Tests of what stands between the widgets of the Tester and the client."""
