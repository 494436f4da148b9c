"""Long checks, one file for each part of scripts/verify.py: ``verify`` prints, and returns whether all is right."""
