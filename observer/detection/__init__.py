"""Detection: thresholds, excursions of residuals beyond them, and where the robot is touched."""
