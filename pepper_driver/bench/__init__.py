"""Benchmarks of ticks, callbacks and long runs."""
