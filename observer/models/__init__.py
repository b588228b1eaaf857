"""Models identified on the shipped plants, one JSON file each."""
