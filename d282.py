import sys
sys.path.insert(0,"/work/wt/linear/scripts")
import numpy as np, lin_freq_ocp as lfo, verify_linear as v, random_linear as rl
for s in (282,250):
    g=rl.random_linear(s).good
    ref=v.solved_plainly(g)
    print(s,"ref y max",abs(ref.y).max(),"ref primal", abs(ref.program.A@ref.z-ref.program.b).max(), np.maximum(ref.program.G@ref.z-ref.program.h,0).max())
    A=ref.program.A.toarray(); sv=np.linalg.svd(A)[1]; print("sv",sv[0],sv[-4:], A.shape, np.linalg.cond(g.dynamics.A) if g.dynamics.A.ndim==2 else "tv", abs(np.linalg.eigvals(g.dynamics.A)))
    r=lfo.solve(g,method="convex",throw=False)
    if r.multipliers: 
        m=r.multipliers; print({k:abs(getattr(m,k)).max() for k in("eta","mu","nu","rho_x","rho_u")})
        z=np.concatenate([r.trajectory.x.ravel(),r.trajectory.u.ravel()]); print("ours primal",abs(ref.program.A@z-ref.program.b).max(),np.maximum(ref.program.G@z-ref.program.h,0).max())
    print(g.state_stop.T*1, g.initial_state, g.terminal_state)
