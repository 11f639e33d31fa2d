"""Robot models and the numbers by which the hierarchy drives them."""
