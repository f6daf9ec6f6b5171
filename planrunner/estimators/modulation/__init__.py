"""How much of constant errors a rotation cycle leaves in the navigation."""
