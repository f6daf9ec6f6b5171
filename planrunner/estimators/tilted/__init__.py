"""Scale factors of several axes in one tilted mounting, and the fixture angles that they rest on."""
