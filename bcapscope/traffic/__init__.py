"""Live or recorded traffic: observations, their pairing into calls, handles, slave mode, filters."""
