"""Transports for asyncio: UDP and TCP. The transports do not interpret the bytes that they carry."""
