"""Traffic in processes of its own: one reads it, one searches it, and the screen is told.

Nothing here but `traffic_feed` belongs to the process of the screen, and nothing imports Textual, so that a
process starts at once and its work never delays a key.
"""
