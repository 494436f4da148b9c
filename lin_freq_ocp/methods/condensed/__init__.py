"""A dual active-set method in the few unknowns that stop bands and ends leave, for one problem solved again and again."""
