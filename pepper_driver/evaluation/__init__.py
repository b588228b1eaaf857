"""Proves observers: performs seeded runs, steps observers over them, scores what they tell, writes the results."""
