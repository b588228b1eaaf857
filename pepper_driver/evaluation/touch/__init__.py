"""The judge of touch: people touch simulated robots of a population; observers are scored by the events they report."""
