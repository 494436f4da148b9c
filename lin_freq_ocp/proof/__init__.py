"""Proofs: files from which a checker that shares no code with the package confirms a claim (docs/proof.md)."""
