"""Residuals: tracking errors that free motion does not explain, by method."""
