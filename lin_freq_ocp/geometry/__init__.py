"""Polyhedra, by linear programs of HiGHS."""
