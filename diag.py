import sys, dataclasses
sys.path.insert(0,"/work/wt/linear/scripts")
import numpy as np, lin_freq_ocp as lfo, verify_linear as v, random_linear as rl
for s in map(int,sys.argv[1:]):
    a=rl.random_linear(s); g=a.good
    ref=v.solved_plainly(g); st,c=ref.status,ref.cost
    print(f"=== {s} n{g.state_dim} m{g.control_dim} T{g.horizon} plain {st} {c!r} err {ref.error:.1e}")
    for m in ("spectral","convex"):
        for name,p,ux,uu,uc in (("bad",a.problem,a.units.x,a.units.u,a.units.cost),("good",g,1,1,1)):
            try: r=lfo.solve(p,throw=False,method=m)
            except Exception as e: print("  ",m,name,type(e).__name__,str(e)[:80]); continue
            if r.trajectory is None: print("  ",m,name,r.status,r.message); continue
            x,u=r.trajectory.x*ux,r.trajectory.u*uu
            k=r.certificate
            print("  ",m,name,r.status,"J",repr(g.value(x,u)),"S",f"{v.cost_scale(g,x,u):.3g}","|x|",f"{abs(x).max():.3g} |u| {abs(u).max():.3g}", k.pmp,f"gap {k.gap:.1e}" if k.gap is not None else None,k.bound and k.bound.kind,k.worst.name,f"{k.worst.relative:.1e}",r.message)
