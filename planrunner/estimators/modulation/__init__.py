"""How much of constant sensor errors remains in a navigation with a rotation cycle."""
