"""The services of the stand-in that make it a Pepper for ordinary programs: one class each, with NAOqi's names."""
