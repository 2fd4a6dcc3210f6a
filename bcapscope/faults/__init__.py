"""Faults: disturbances as data, and a seeded injector that applies them to each message.

The proxy and the simulator share this package. `fault_kinds` defines the faults, `document` and
`fault_notation` read faults, and `fault_injector` applies faults.
"""
