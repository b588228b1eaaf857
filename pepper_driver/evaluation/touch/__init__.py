"""The judge of touch: people touch simulated robots of a population, and observers are scored as a user hears them."""
