"""The catalogue of the error model: terms and effects as functions of the stimulus, and the addition of effects to simulations."""
