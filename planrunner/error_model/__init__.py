"""The catalogue of the error model: terms and effects over what a sensor feels, and simulations that hold them."""
