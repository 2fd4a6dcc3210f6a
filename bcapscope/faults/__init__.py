"""Trouble on purpose: faults as data, and a seeded machine that decides what becomes of each message.

The proxy and the simulator share it. `fault` has the faults, `document` and `fault_notation` read them,
`fault_injector` applies them.
"""
