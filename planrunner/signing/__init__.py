"""Handles keys, key rings and signatures (Ed25519, DSSE, in-toto statements)."""
