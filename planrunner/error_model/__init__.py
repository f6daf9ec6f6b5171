"""The catalogue of the error model. The catalogue contains the terms and effects as functions of the stimulus, and the functions
that add effects to simulations."""
