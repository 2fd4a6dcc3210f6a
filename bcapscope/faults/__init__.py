"""Describes faults as data, and applies faults to messages with seeded random numbers.

The proxy and the simulator share this package. `fault_kinds` defines the faults, `document` and
`fault_notation` read faults, and `fault_injector` applies faults.
"""
