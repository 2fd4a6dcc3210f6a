"""The Tester's session with a controller: how the Tester connects, makes calls, arms, halts the robot and
recovers from errors. This package has no user interface.
"""
