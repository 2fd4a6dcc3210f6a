"""Carrying bytes: UDP, TCP and memory for asyncio, and the clock. Nothing here knows what the bytes mean."""
