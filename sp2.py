import sys
sys.path.insert(0,"/work/wt/linear/scripts")
import numpy as np, lin_freq_ocp as lfo, random_linear as rl, verify_linear as v
for s in map(int,sys.argv[1:]):
    a=rl.random_linear(s); g=a.good
    ref=v.solved_plainly(g)
    for m in ("spectral","convex"):
        r=lfo.solve(g,method=m,throw=False); c=r.certificate
        z=np.concatenate([r.trajectory.x.ravel(),r.trajectory.u.ravel()])
        P=ref.program
        me=abs(P.A@z-P.b); mi=np.maximum(P.G@z-P.h,0)
        print(s,m,r.cost,"viol eq %.1e ineq %.1e"%(me.max(),mi.max(initial=0)),"worst rows",np.argsort(abs(ref.y)*np.r_[me,mi])[-3:],"of",len(me),"ref y max %.1e eq %.1e"%(abs(ref.y).max(),abs(ref.y[:len(me)]).max()), "ref viol %.1e"%abs(P.A@ref.z-P.b).max(), [ (k.name,"%.0e"%k.relative) for k in c.conditions if k.label in("C-iii","S-x","S-u","C-vi","C-vii")])
