"""Judgement: pure functions over observations and exchanges that give frozen findings."""
