"""The catalogue of the error model. It contains terms and effects as functions of the stimulus, and adds effects to simulations."""
