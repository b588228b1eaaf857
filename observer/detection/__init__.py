"""Detection: thresholds, excursions of residuals beyond them, and isolation of contacts."""
