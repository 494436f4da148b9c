"""The public functions and the classes that they return, with everything users call on these."""
