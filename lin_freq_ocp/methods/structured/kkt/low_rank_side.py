"""The side of many rows of low rank, F = (E; C V'): masks on a grid finer than that of their band.

With J = (E; V') P (E; V')', which costs no more columns than E and V have, and the compliance C_b of the rows C V',

    J_ee nu_e + J_ev g = r_e,   C (J_ve nu_e + J_vv g) + C_b nu = r,   g = C'nu.

a = (J_ve nu_e + J_vv g) - J_ve J_ee^-1 r_e is found from (K + C' C_b^-1 C) a = C' C_b^-1 r~, K the inverse of the Schur
complement of J_ee, r~ = r - C J_ve J_ee^-1 r_e; then nu = C_b^-1 (r~ - C a). Sums of positive matrices lose nothing;
the difference in nu does where a row is active, which the refinement of the step makes good.
"""
