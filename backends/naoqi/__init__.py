"""A real Pepper over NAOqi."""
