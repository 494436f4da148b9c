"""A dual active-set method in the unknowns that stop bands and ends leave, for repeated solves of one problem."""
