import sys
sys.path.insert(0,"/work/wt/linear/scripts")
import numpy as np, lin_freq_ocp as lfo, random_linear as rl, verify_linear as v
for s in map(int,sys.argv[1:]):
    a=rl.random_linear(s); g=a.good
    r=lfo.solve(g,method="spectral",throw=False); c=r.certificate; b=c.bound
    ref=v.solved_plainly(g); z=np.concatenate([r.trajectory.x.ravel(),r.trajectory.u.ravel()])
    print(s,r.status,r.cost,"plain",ref.cost,"S",v.cost_scale(g,r.trajectory.x,r.trajectory.u),"gap",c.gap,"terms dyn %.1e freq %.1e stage %.1e rounding %.1e"%(b.dynamics_term,b.frequency_term,b.stage_term,b.rounding),"stagegaps",b.stage_gaps.sum() if b.stage_gaps is not None else None, "fit",v.fitted_error(ref.program,z),"eta",abs(r.multipliers.eta).max())
