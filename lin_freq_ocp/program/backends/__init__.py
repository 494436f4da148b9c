"""SOLVE, with other people's solvers: a Program goes in, a Solution in the same units comes out."""
