"""ALMotion of the stand-in: how its joints and wheels move."""
