"""The Tester's session with a controller: connect, call, arm, halt, recover. This package has no user
interface.
"""
