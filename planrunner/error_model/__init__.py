"""The catalogue of the error model: terms and effects as functions of the stimulus, and effects that are added to simulations."""
