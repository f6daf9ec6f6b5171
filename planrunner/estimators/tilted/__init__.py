"""Scale factors of several axes in one tilted mounting, and the fixture angles on which they depend."""
