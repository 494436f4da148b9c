import sys
sys.path.insert(0,"/work/wt/linear/scripts")
import numpy as np, lin_freq_ocp as lfo, verify_linear as v, random_linear as rl
import lin_freq_ocp.methods.convex as c
orig=c._measured
def m(tr,sc,pr,so,tol):
    a=orig(tr,sc,pr,so,tol)
    r=a.candidate.residuals
    own=c.own_scaling(tr,a.z,sc.columns) if a.z is not None else sc
    print("   attempt",so.words,a.candidate.status,f"err {a.error:.1e}",r and f"p{r.primal:.1e} d{r.dual:.1e} g{r.gap:.1e}","cols",f"{sc.columns.min():.1e}..{sc.columns.max():.1e} cost {sc.cost:.1e} dist {c_dist(own,sc):.1e}", a.candidate.trajectory and tr.problem.value(a.candidate.trajectory.x,a.candidate.trajectory.u))
    return a
from lin_freq_ocp.transcription.units import distance as c_dist
c._measured=m
for s in map(int,sys.argv[1:]):
    a=rl.random_linear(s); g=a.good
    print("===",s,g)
    ref=v.solved_plainly(g); print("plain",ref.status,ref.cost,ref.error, abs(ref.z).max())
    for p in (a.problem,g):
        r=lfo.solve(p,throw=False,method="convex"); print(r.status,r.message)
