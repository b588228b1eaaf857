"""Services of NAOqi that clients of the stand-in call."""
