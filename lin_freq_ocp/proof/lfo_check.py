"""Check a proof of docs/proof.md: python lfo_check.py FILE [--limit N]. Imports the standard library and python-flint.

The last line printed is VERIFIED lb ub (lb <= J* <= ub) or INFEASIBLE, exit status 0; status 1: a line of the proof
fails, or needs more operations than N (by default 2e7, and 1000 a byte); 2: not a proof. Numbers are balls (arb):
`x <= y` is true only if it holds for all numbers in both.
"""

import functools
import hashlib
import itertools
import json
import math
import os
import re
import sys
from collections import Counter
from decimal import MAX_EMAX, MIN_EMIN, ROUND_CEILING, ROUND_FLOOR, Context, Decimal

try:
    from flint import acb, acb_poly, arb, arb_mat, arb_poly, ctx, fmpq
except ModuleNotFoundError:
    print("lfo_check needs python-flint; install it with: pip install python-flint", file=sys.stderr)
    raise SystemExit(2) from None

LONGEST_LINE, MOST_STAGES, MOST_BITS, MOST_GENERATORS, HALVINGS = 2**28, 10**6, 100_000, 500, 60
TAYLOR = 20  # terms of a spectrum of N samples around a frequency: within 1/N, the rest is below 1e-22 sum |y|
INFINITY, ZERO, ONE, UNIT, UNKNOWN = arb.pos_inf(), arb(0), arb(1), arb(0, 1), arb(0, arb.pos_inf())
LEAST_WORK, WORK_BY_BYTE = 2e7, 1000  # operations allowed: some seconds, and in proportion for long files
MOST_SWITCHES, MOST_LEVELS, MOST_ORDER, MOST_LATTICE = 64, 64, 10**4, 10**6
NEWTON_BITS = 40  # the box of angles in which amplitudes meet their limits is so small
UNDERFLOW = arb(2) ** -1000  # more than all underflows of a recursion in doubles lose
LATTICE, CURVATURE = 1, 2  # operations of a value of a recursion, and of an entry of a pivot
STAGE, SINE, SAME_BLOCK = 24, 32, 512  # operations of a stage of lists, and of a sine; exponents within one product
NUMBER = re.compile(r"(-?)0x([0-9a-f]+)(?:\.([0-9a-f]*))?(?:p([+-]?[0-9]{1,6}))?")


class Failed(Exception):
    """The proof does not prove what it says."""


def require(truth, message):
    """Fail unless something is certainly true."""
    if not truth:
        raise Failed(message)


class Work:
    """The operations so far, how many are allowed, and the words of the longest number of the file."""

    done, most, words = 0.0, math.inf, 1


def spend(count, words=0):
    """Count operations before they are made: a few bytes can ask for years of them.

    One on numbers of many words of 64 bits counts as many times as flint takes longer for it. 1e7 take some 2 seconds.
    """
    words = words or Work.words
    Work.done += count * (1 + words * (64 + words) / 2048)
    if Work.done > Work.most:
        needed, limit = f"{Work.done:.3g} operations on 64 bits, or more", f"{Work.most:.3g}"
        raise Failed(f"needs {needed}; the limit is {limit}, and --limit N sets another")


def words_of(exact):
    """Return how many words of 64 bits a rational number takes."""
    return 1 + (int(exact.p).bit_length() + int(exact.q).bit_length()) // 64


class Lines:
    """The lines of a file, one object each; `hash` is of the text of all lines taken."""

    def __init__(self, file):
        self.file, self.number, self.hash, self.ahead, self.text = file, 0, hashlib.sha256(), {}, b""
        self.advance()

    def advance(self):
        before = self.ahead
        self.hash.update(self.text)
        self.text, self.number, self.at = self.file.readline(LONGEST_LINE), self.number + 1, self.number + 1
        require(self.text == b"" or self.text.endswith(b"\n"), "the file ends within this line, or it is too long")
        self.ahead = json.loads(self.text.decode(), object_pairs_hook=distinct, parse_float=str) if self.text else {}
        require(isinstance(self.ahead, dict), "not a JSON object")
        self.at = self.number - 1
        return before

    def take(self, needed, allowed=""):
        """Return the line ahead, which must have the needed fields and may have the allowed ones."""
        self.at, needed, allowed, got = self.number, set(needed.split()), set(allowed.split()), set(self.ahead)
        require(needed <= got <= needed | allowed, f"got the fields {sorted(got)}; expected {needed}, maybe {allowed}")
        return self.advance()

    def section(self, name, fields, allowed=""):
        require(self.ahead.get("section") == name, f"expected the section {name}")
        return self.take(f"section {fields}", allowed)


def distinct(pairs):
    require(len(dict(pairs)) == len(pairs), "a field stands twice")
    return dict(pairs)


def integer(value, low, high):
    require(type(value) is int and low <= value <= high, f"{value!r:.40} is not an integer from {low} to {high}")
    return value


def number(text, infinite=False):
    """Return a number, exactly."""
    if infinite and text in ("inf", "-inf"):
        return INFINITY if text == "inf" else -INFINITY
    found = NUMBER.fullmatch(text) if isinstance(text, str) else None
    require(found, f"{text!r:.40} is not a hexadecimal number")
    sign, whole, part, power = found.groups(default="")
    Work.words = max(Work.words, 1 + (len(whole) + len(part)) // 16)
    return arb((int(sign + whole + part, 16), int(power or 0) - 4 * len(part)))


def double(ball):
    """Return the middle of a ball as a double. It is finite: minima with infinite ones may leave a train out."""
    require(math.isfinite(float(ball)), "a sum is larger than all doubles")
    return float(ball)


def rounding(operations, largest):
    """Return a bound of the error of sums in doubles, below and above the smallest normal one."""
    double(2 * largest)
    return operations * arb(2) ** -52 * largest + UNDERFLOW


def matrix(value, rows, columns=None, infinite=False):
    """Return numbers as a matrix; without a number of columns, as one column; None rows: any number."""
    require(isinstance(value, list) and rows in (None, len(value)), f"expected {rows} rows")
    given = value if columns is not None else [[one] for one in value]
    flat = [number(one, infinite) for row in given for one in row]
    require(all(isinstance(row, list) and len(row) == (columns or 1) for row in given), f"expected {columns} columns")
    return arb_mat(len(value), columns or 1, flat)


def rational(exact):
    mantissa, power = exact.man_exp()
    spend(1, 1 + abs(int(power)) // 64)
    return fmpq(mantissa) * fmpq(2) ** int(power)


def total(balls):
    return sum(balls, ZERO)


def largest(balls, found=-INFINITY):
    return functools.reduce(arb.max, balls, found)


def norm(v, order):
    if order == "2":
        return total(x * x for x in v).nonnegative_part().sqrt()
    return total(map(abs, v)) if order == "1" else largest(map(abs, v), ZERO)


# ------------------------------------------------------------ PROBLEM: what is believed


def over_time(lines, key, value, count, **shapes):
    """Return what lines say that are valid from their time on, one object a time; absent fields stay as before."""
    spend(count)
    found = []
    while lines.ahead.get(key) == value:
        start = integer(lines.ahead.get("from", len(found)), len(found), count - 1 if found else 0)
        line = lines.take(key, f"from {' '.join(shapes)}")
        given = {name: matrix(line[name], *shapes[name], infinite=key == "bounds") for name in shapes if name in line}
        found += found[-1:] * (start - len(found))
        found.append({**(found[-1] if found else {}), **given})
        require(set(found[-1]) == set(shapes), f"the first line of {key} {value} needs {list(shapes)}")
    require(found, f"expected {key}: {value}")
    return found + found[-1:] * (count - len(found))


def beside(a, b):
    """Return the matrix (a b)."""
    require(a.nrows() == b.nrows(), "different numbers of rows")
    return arb_mat(a.nrows(), a.ncols() + b.ncols(), [one for p, q in zip(a.tolist(), b.tolist()) for one in p + q])


def once(objects):
    return {id(one): one for one in objects}.values()


class Problem:
    """v_t = (x_t, u_t) has components 0 .. n + m - 1; v_T = x_T. Vectors are columns."""

    def __init__(self, lines):
        self.head = head = lines.section("problem", "name horizon states controls modes")
        names = [head[key] for key in ("states", "controls", "modes")]
        require(all(isinstance(one, list) and one for one in names), "expected names of states, controls and modes")
        self.T, self.n, self.m = integer(head["horizon"], 1, MOST_STAGES), len(names[0]), len(names[1])
        T, n, k = self.T, self.n, self.n + self.m
        spend(T * (STAGE + k))
        shapes = {"A": (n, n), "B": (n, self.m), "d": (n,), "G": (None, n), "H": (None, self.m), "h": (None,)}
        self.modes = [over_time(lines, "mode", i, T, **shapes) for i in range(len(names[2]))]
        for mode in once(mode for modes in self.modes for mode in modes):
            mode["map"], mode["rows"] = beside(mode["A"], mode["B"]), beside(mode["G"], mode["H"])
            require(mode["rows"].nrows() == mode["h"].nrows(), "as many limits h as rows G")
        self.costs = over_time(lines, "cost", "stage", T, hessian=(k, k), center=(k,), linear=(k,))
        self.costs += over_time(lines, "cost", "end", 1, hessian=(n, n), center=(n,), linear=(n,))
        bounds = over_time(lines, "bounds", "stage", T, lower=(k,), upper=(k,))
        bounds += over_time(lines, "bounds", "end", 1, lower=(n,), upper=(n,))
        for one in once(bounds):
            one["lower"], one["upper"] = one["lower"].entries(), one["upper"].entries()
            pairs = list(zip(one["lower"], one["upper"]))
            require(all(a <= b and a < INFINITY and b > -INFINITY for a, b in pairs), "empty bounds")
            one["box"] = [a.union(b) if (b - a).is_finite() else UNKNOWN for a, b in pairs]
            one["fixed"] = [i for i, (a, b) in enumerate(pairs) if a == b]
        self.lower, self.upper, self.boxes = ([one[key] for one in bounds] for key in ("lower", "upper", "box"))
        self.fixed = [(t, i) for t, one in enumerate(bounds) for i in one["fixed"] if t > 0 or i >= n]
        self.stops, self.terms = {}, []
        while "stop" in lines.ahead:
            self.add_stop(lines.take("stop samples bins"))
        while "term" in lines.ahead:
            own = "limits output first window" if lines.ahead.get("gauge") == "all" else "limit values"
            self.terms.append(Term(self, lines.take(f"term name gauge weight {own}")))

    def add_stop(self, line):
        """Note the removed bins of a component, and the kernel of the convolution that finds what lies in them."""
        i, N = integer(line["stop"], 0, self.n + self.m - 1), integer(line["samples"], self.T, self.T + 1)
        require(i not in self.stops and (i < self.n or N == self.T), "a second stop band, or too many samples")
        require(line["bins"], "a stop band without bins")
        spend(N * (2 * SINE + 8 * len(line["bins"])))
        sines, bins, kernel = [arb.sin_pi_fmpq(fmpq(j, N)) for j in range(2 * N)], [], [ZERO] * N
        for a, b in line["bins"]:
            bins += range(integer(a, bins[-1] + 1 if bins else 0, N // 2), integer(b, a, N // 2) + 1)
            for t in range(N):
                ends = sines[(2 * b + 1) * t % (2 * N)] - sines[(2 * a - 1) * t % (2 * N)]
                waves = ends / sines[t] if t else 2 * (b - a + 1)
                kernel[t] += arb(waves - (a == 0) - (2 * b == N) * (-1) ** t) / N
        self.stops[i] = N, bins, arb_poly(kernel)

    def removed(self, i, signal):
        """Return the part of a signal that lies in the removed bins of a component: a circular convolution."""
        N, _, kernel = self.stops[i]
        spend(N * (8 + 4 * N.bit_length() * blocks(signal)))
        found = (kernel * arb_poly(signal)).coeffs()
        return [total(found[t::N]) for t in range(N)]

    def output(self, line):
        """Return t0, the window, and the factors of a linear output of v_t."""
        window, factors = line["window"], matrix(line["output"], self.n + self.m).entries()
        window = [ONE] * integer(window, 1, self.T + 1) if type(window) is int else matrix(window, None).entries()
        first = integer(line["first"], 0, self.T + 1 - len(window))
        of_states = all(c.is_zero() for c in factors[self.n :])
        spend(len(window))
        require(of_states or first + len(window) <= self.T, "there is no control at T")
        return first, window, [(i, c) for i, c in enumerate(factors) if not c.is_zero()]

    def summary(self):
        yield ", ".join(f"{key}: {value!r}" for key, value in self.head.items() if key != "section")
        for i, (N, bins, _) in self.stops.items():
            yield f"component {i}: {len(bins)} bins of the DFT of {N} samples are removed, from {bins[0]} to {bins[-1]}"
        yield from (f"{count} x {name}" for name, count in Counter(term.name for term in self.terms).items())


def blocks(signal):
    """Return how many products flint makes of a signal: one for numbers in a row whose exponents are close."""
    count, low, high = 1, None, None
    for one in (int(x.abs_upper().man_exp()[1]) for x in signal if x.is_finite() and not x.is_zero()):
        low, high = (one, one) if low is None else (min(low, one), max(high, one))
        if high - low > SAME_BLOCK:
            count, low, high = count + 1, one, one
    return count


def angle(frequency):
    """Return a frequency in units of pi rad/sample."""
    if isinstance(frequency, list):
        return fmpq(2 * integer(frequency[0], 0, 2**60), integer(frequency[1], 1, 2**60))
    return number(frequency) / arb.pi()


def wave(first, window, factors, w):
    """Return Re and Im of sum_s w_s y_{t0+s} exp(-i pi w s) as rows: lists of (t, component, factor)."""
    exact = isinstance(w, fmpq)
    spend(len(window) * (SINE + 4 * len(factors)))
    turns = [arb.sin_cos_pi_fmpq(w * s) if exact else (w * s).sin_cos_pi() for s in range(len(window))]
    parts = [(first + s, i, h * c, turns[s]) for s, h in enumerate(window) for i, c in factors]
    return [(t, i, c * cosine) for t, i, c, (_, cosine) in parts], [(t, i, -c * sine) for t, i, c, (sine, _) in parts]


class Term:
    """h(v) = weight max(gauge(v) - limit, 0), v = L (x, u) + constants; rows of L: lists of (t, component, factor)."""

    def __init__(self, problem, line):
        integer(line["term"], len(problem.terms), len(problem.terms))
        self.name, self.gauge, self.weight = repr(line["name"]), line["gauge"], number(line["weight"], infinite=True)
        require(self.gauge in ("1", "2", "inf", "max", "cone", "all") and self.weight >= 0, "unknown gauge or weight")
        self.hard, self.rows, self.constants = self.weight == INFINITY, [], []
        self.limit, self.everywhere = ONE if self.gauge == "all" else number(line["limit"]), self.gauge == "all"
        if self.everywhere:
            self.output, self.pieces = problem.output(line), matrix(line["limits"], None, 4).tolist()
            right = all(0 <= a <= b <= 7 and c >= 0 and d >= 0 for a, b, c, d in self.pieces)
            require(right, "limits: expected 0 <= low <= high <= 7, and no negative limits")
        for value in () if self.everywhere else line["values"]:
            kind = "output first window frequency" if "output" in value else "row constant"
            require(set(value) == set(kind.split()), f"a value has the fields {kind}")
            if "output" in value:
                self.rows += wave(*problem.output(value), angle(value["frequency"]))
                self.constants += [ZERO, ZERO]
            else:
                entries = [(integer(t, 0, problem.T), i, number(c)) for t, i, c in value["row"]]
                self.rows.append([(t, integer(i, 0, len(problem.lower[t]) - 1), c) for t, i, c in entries])
                self.constants.append(number(value["constant"]))
        require(self.limit >= 0 or self.gauge == "max", "a negative limit of a norm")
        require(self.gauge != "cone" or (self.limit == 0 and self.hard), "a cone has the limit 0 and the weight inf")
        self.equation = self.hard and self.limit == 0 and self.gauge in ("1", "2", "inf")

    def cost(self, v, level):
        """Return an upper bound on the term at a trajectory; fail unless what must hold does."""
        require(not self.everywhere or below(self, v, level), f"{self.name} is not proven to be below {level.str(9)}")
        values = [total(c * v[t][i, 0] for t, i, c in row) + one for row, one in zip(self.rows, self.constants)]
        values = [level] if self.everywhere else values
        size = largest(values) if self.gauge in ("max", "all") else norm(values, self.gauge)
        size = norm(values[1:], "2") - values[0] if self.gauge == "cone" else size
        require(not self.hard or self.equation or size <= self.limit, f"the point violates {self.name}")
        return ZERO if self.hard else self.weight * (size - self.limit).max(ZERO)

    def conjugate(self, given, normal):
        """Return h* at multipliers [(frequency or None, list), ...], less <multipliers, constants>; and their rows."""
        size, pairs = ZERO, []
        require(self.everywhere or len(given) == 1, f"{self.name}: a second line")
        for frequency, values in given:
            require((frequency is not None) == self.everywhere, f"{self.name}: a frequency is missing, or needless")
            rows = wave(*self.output, angle(frequency)) if self.everywhere else self.rows
            values = matrix(values, len(rows)).entries()
            pairs += zip(values, rows)
            in_cone = self.gauge != "cone" or norm(values[1:], "2") <= -values[0]
            above = self.gauge != "max" or all(one >= 0 for one in values)
            require(in_cone and above, f"{self.name}: multipliers outside of the dual cone")
            dual = norm(values, {"1": "inf", "inf": "1", "max": "1"}.get(self.gauge, "2"))
            size += dual * (self.limit_at(frequency) if self.everywhere else ONE)
        require(self.hard or size <= (self.weight if normal else ZERO), f"{self.name}: multipliers above the weight")
        return size * self.limit - total(one * constant for (one, _), constant in zip(pairs, self.constants)), pairs

    def limit_at(self, frequency):
        spend(len(self.pieces))
        w = number(frequency) if isinstance(frequency, str) else arb.pi() * angle(frequency)
        for low, high, at_low, at_high in self.pieces:
            if low <= w <= high:
                return at_low + (at_high - at_low) * (w - low) / (high - low) if high > low else at_low
        raise Failed(f"{self.name}: a frequency outside of the limits")


# ------------------------------------------------------------ POINT: an upper bound


def below(term, v, level):
    """Whether |Y(w)| <= level * limit(w) over all frequencies, by cells: Taylor around their middles, and a rest."""
    first, window, factors = term.output
    spend(len(window) * (len(factors) + 4 * TAYLOR))
    y = [h * total(c * v[first + s][i, 0] for i, c in factors) for s, h in enumerate(window)]
    N, middle, turns = len(y), arb(len(y) - 1) / 2, (acb(1), acb(0, -1), acb(-1), acb(0, 1))
    derivatives = [acb_poly([one * (s - middle) ** k for s, one in enumerate(y)]) for k in range(TAYLOR)]
    for low, high, at_low, at_high in term.pieces:
        count = max(1, int(((high - low) * N / 2).upper().ceil().unique_fmpz()))
        spend(count * TAYLOR * (N + 4 * TAYLOR))
        half, slope = (high - low) / (2 * count), level * (at_high - at_low) / (high - low) if high > low else ZERO
        rest = norm(y, "1") * (half * N / 2) ** TAYLOR / arb(TAYLOR).gamma()
        for w in (low + (2 * j + 1) * half for j in range(count)):
            parts = [turns[k % 4] * p(acb(w.cos(), -w.sin())) / arb(k + 1).gamma() for k, p in enumerate(derivatives)]
            real, imaginary = arb_poly([part.real for part in parts]), arb_poly([part.imag for part in parts])
            limit = arb_poly([level * at_low + slope * (w - low) - rest, slope])
            if not (limit[0] >= abs(slope) * half and never_negative(limit**2 - real**2 - imaginary**2, half)):
                return False
    return True


def never_negative(g, half, depth=HALVINGS):
    """Whether a polynomial is certainly >= 0 on [-half, half]: by its expansion, its curvature, or by parts."""
    a = [*g.coeffs(), ZERO, ZERO, ZERO]
    spend(len(a) ** 2)
    beyond = total(abs(c) * half ** (k + 1) for k, c in enumerate(a[3:]))
    plainly = a[0] - abs(a[1]) * half - (beyond - a[2]).max(ZERO) * half**2 >= 0
    if plainly or (a[2] > beyond and 4 * a[0] * (a[2] - beyond) >= a[1] ** 2):
        return True
    return depth > 0 and all(never_negative(g(arb_poly([c, 1])), half / 2, depth - 1) for c in (half / 2, -half / 2))


def trajectory(modes, x, u):
    """Return v_0 .. v_T."""
    v = []
    spend(len(u) * x.nrows() * 8)
    for mode, control in zip(modes, u):
        v.append(arb_mat(x.tolist() + control.tolist()))
        x = mode["map"] * v[-1] + mode["d"]
    return [*v, x]


def kept(problem, signals):
    """Take the removed bins out of signals of the controls, T matrices with m rows, in place."""
    for i in (i for i in problem.stops if i >= problem.n):
        for r in range(signals[0].ncols()):
            for t, one in enumerate(problem.removed(i, [part[i - problem.n, r] for part in signals])):
                signals[t][i - problem.n, r] -= one
    return signals


def equations(problem):
    """Yield (row, target): what must hold beyond the state equation, x_0 and removed bins of controls."""
    for t, i in problem.fixed:
        yield [(t, i, ONE)], problem.lower[t][i]
    for term in problem.terms:
        yield from zip(term.rows, (-one for one in term.constants)) if term.equation else ()
    for i, (N, bins, _) in problem.stops.items():
        for row in (row for k in bins if i < problem.n for row in wave(0, [ONE] * N, [(i, ONE)], fmpq(2 * k, N))):
            yield row, ZERO


def correct(problem, modes, x, u):
    """Add P W'(W P W')^-1 residuals to controls: W are the equations in terms of the controls, P removes bins."""
    wanted, v = list(equations(problem)), trajectory(modes, x, u)
    entries, W, q = [[] for _ in range(problem.T + 1)], [None] * problem.T, len(wanted)
    spend(problem.T * q * ((problem.n + problem.m) * problem.n + problem.m * q) + q**3)
    spend(sum(len(row) for row, _ in wanted))
    for r, (row, _) in enumerate(wanted):
        for t, i, c in row:
            entries[t].append((i, r, c))
    pulled, gram = arb_mat(problem.n, q), arb_mat(q, q)
    for t in range(problem.T, -1, -1):
        both = modes[t]["map"].transpose() * pulled if t < problem.T else pulled
        for i, r, c in entries[t]:
            both[i, r] += c
        pulled = arb_mat(problem.n, q, both.entries()[: problem.n * q])
        if t < problem.T:
            W[t] = arb_mat(problem.m, q, both.entries()[problem.n * q :])
    moves = kept(problem, [arb_mat(part) for part in W])
    for part, move in zip(W, moves):
        gram += part.transpose() * move
    misses = [target - total(c * v[t][i, 0] for t, i, c in row) for row, target in wanted]
    for r in (r for r in range(q) if gram[r, r].is_zero() and misses[r].is_zero()):
        gram[r, r] = ONE  # holds already, and no control can move it
    weights = gram.solve(arb_mat(q, 1, misses)) if q else arb_mat(0, 1)
    return [now + move * weights for now, move in zip(u, moves)]


def upper_bound(problem, lines):
    """Return an upper bound on the cost of controls near the given ones; fail unless they meet all constraints."""
    T, head, stages, cost = problem.T, lines.section("point", "x levels"), [], ZERO
    masks = sum(term.everywhere for term in problem.terms)
    x, levels = matrix(head["x"], problem.n), iter(matrix(head["levels"], masks).entries())
    for t in range(T):
        stages.append(lines.take("t u mode"))
        integer(stages[t]["t"], t, t)
    modes = [problem.modes[integer(one["mode"], 0, len(problem.modes) - 1)][t] for t, one in enumerate(stages)]
    u = kept(problem, [matrix(one["u"], problem.m) for one in stages])
    v = trajectory(modes, x, correct(problem, modes, x, u))
    for t, i in problem.fixed:
        v[t][i, 0] = problem.lower[t][i]
    for t, here in enumerate(v):
        inside = all(a <= b <= c for a, b, c in zip(problem.lower[t], here.entries(), problem.upper[t]))
        room = (modes[t]["h"] - modes[t]["rows"] * here).entries() if t < T else []
        require(inside and all(one >= 0 for one in room), f"the point is not within its bounds at {t}")
        cost += quadratic(problem.costs[t], here)[0]
    return cost + total(term.cost(v, next(levels) if term.everywhere else ONE) for term in problem.terms)


# ------------------------------------------------------------ NODES: what can be reached


class Stage:
    """What a node can reach at a time: x in a box (a list of balls), and in centre + spread [-1, 1]^k.

    `modes`: of each mode that can hold, the boxes of (x, u) in its region and of its image.
    """

    __slots__ = ("allowed", "box", "modes", "zonotope")

    def __init__(self, box, allowed, zonotope=None):
        self.box, self.allowed, self.modes, self.zonotope = box, allowed, {}, zonotope


def around(box):
    """Return the centre of a box and a diagonal matrix of its radii."""
    diagonal = [one.rad() if i == j else ZERO for i, one in enumerate(box) for j in range(len(box))]
    return arb_mat([[one.mid()] for one in box]), arb_mat(len(box), len(box), diagonal)


def meet(a, b):
    """Return a box around the intersection of two, None if it is certainly empty."""
    pairs = list(zip(a, b))
    spend(4 * len(pairs))
    found = [x.intersection(y) if (x - y).is_finite() else y if y.is_finite() else x for x, y in pairs if x.overlaps(y)]
    return found if len(found) == len(pairs) else None


def cut(box, rows, limits):
    """Return a box around the points of a box with rows v <= limits, None if there is certainly none."""
    for row, limit in 2 * list(zip(rows.tolist(), limits.entries())):  # twice: rows that come first gain, too
        for k, c in ((k, c) for k, c in enumerate(row) if not c.is_zero()):
            spend(8 + 2 * len(box))
            side = (limit - total(row[i] * box[i] for i in range(len(box)) if i != k and not row[i].is_zero())) / c
            if box[k].is_finite() and side.is_finite():
                low, high = (box[k].lower(), side.upper()) if c > 0 else (side.lower(), box[k].upper())
                half = meet([box[k]], [low.union(high)]) if low <= high else None
                if half is None:
                    return None
                box = [*box[:k], *half, *box[k + 1 :]]
    return box


def reach(problem, before, start, kept_modes, forward):
    """Return the stages of a node, with only some modes kept at a time; None if it can reach nothing."""
    stages, n = list(before), problem.n
    spend((problem.T - start) * STAGE * (1 + (4 if forward else 1) * len(problem.modes)))
    stages[start] = Stage(stages[start].box, stages[start].allowed & kept_modes, stages[start].zonotope)
    for t in range(start, problem.T):
        stages[t] = stage = Stage(stages[t].box, stages[t].allowed, stages[t].zonotope)
        controls, beyond, images = problem.boxes[t][n:], problem.boxes[t + 1][:n], {}
        if not forward:
            stage.modes = {i: (stage.box + controls, beyond) for i in stage.allowed}
            continue
        (centre, spread), (middle, radii) = stage.zonotope or around(stage.box), around(controls)
        for i in sorted(stage.allowed):
            mode = problem.modes[i][t]
            box = cut(stage.box + controls, mode["rows"], mode["h"])
            spend(n * (3 * (n + problem.m) + (n + 2) * (spread.ncols() + problem.m)))
            moved = mode["A"] * centre + mode["B"] * middle + mode["d"]
            turned = beside(mode["A"] * spread, mode["B"] * radii)
            outer = [c + total(map(abs, row)) * UNIT for c, row in zip(moved.entries(), turned.tolist())]
            image = (mode["map"] * arb_mat([[one] for one in box]) + mode["d"]).entries() if box else None
            for other in (before[t + 1].box, outer):
                image = meet(image, other) if image else None
            if image:
                stage.modes[i], images[i], small = (box, image), (moved, turned), turned.ncols() <= MOST_GENERATORS
        if not stage.modes:
            return None
        union = [functools.reduce(arb.union, column) for column in zip(*(one[1] for one in stage.modes.values()))]
        stages[t + 1] = Stage(union, stages[t + 1].allowed, *images.values() if len(images) == 1 and small else ())
    return stages if all(stage.allowed for stage in stages[:-1]) else None


# ------------------------------------------------------------ DUAL: a lower bound


def eliminated(pivot, rest, row):
    """Return a row without its first entry, less the multiple of the pivot's row that makes that entry zero."""
    factor, words = row[0] / pivot, words_of(pivot) + words_of(row[0]) + max(map(words_of, rest))
    spend(8 * len(rest), words)
    return [x - factor * y for x, y in zip(row[1:], rest)]


def least(hessian, last):
    """Return the least v'H v of v with a last component of 1, the last pivot of L D L'; show that H is convex."""
    order = [i for i in range(hessian.nrows()) if i != last] + [last]
    rows, pivot = [[rational(hessian[i, j]) for j in order] for i in order], ZERO
    require(all(row[j] == rows[j][i] for i, row in enumerate(rows) for j in range(i)), "a Hessian is not symmetric")
    while rows:  # L D L' without rounding
        (pivot, *rest), rows = rows[0], rows[1:]
        require(pivot > 0 or (pivot == 0 and not any(rest)), "a Hessian is not positive semidefinite")
        rows = [eliminated(pivot, rest, row) if row[0] else row[1:] for row in rows]
    return arb(pivot)


def quadratic(cost, v):
    """Return 1/2 (v - center)'hessian (v - center) + linear'v and its gradient; show first that it is convex."""
    spend(3 * v.nrows() ** 2)
    if "convex" not in cost:
        least(cost["hessian"], v.nrows() - 1)
    cost["convex"], moved = True, v - cost["center"]
    bent = cost["hessian"] * moved
    return (moved.transpose() * bent)[0, 0] / 2 + (cost["linear"].transpose() * v)[0, 0], bent + cost["linear"]


def charge(gradient, hessian, z, lower, upper):
    """Return a lower bound on min of gradient'd + 1/2 d'H d over lower <= z + d <= upper: by bounds or by curvature."""
    found, spared, bent, used = ZERO, ZERO, [], [i for i in range(len(z)) if hessian[i, i] > 0]
    spend(8 * len(z) + len(used) ** 3)
    for i, g in enumerate(gradient):
        ends = [(g * (end - z[i])).lower() for end in (lower[i], upper[i]) if not (g.is_zero() or end == z[i])]
        least = -largest((-end for end in ends), ZERO)
        curved = i in used and not 2 * hessian[i, i] * least >= -g * g
        found, spared = (found, spared + least) if curved else (found + least, spared)
        bent += [g if curved else ZERO] if i in used else []
    right = arb_mat(len(used), 1, bent)
    try:
        solved = arb_mat([[hessian[i, j] for j in used] for i in used]).solve(right) if used else right
        by_curvature = found - total((right.transpose() * solved).entries()) / 2
        return by_curvature.max(found + spared) if spared.is_finite() else by_curvature
    except ZeroDivisionError:  # a singular Hessian
        return found + spared


def pick(line, key, i, j, size):
    """Return the numbers of modes i, j at a stage: one list for all, or an object by "i,j", "i" or ""."""
    given = line.get(key)
    if isinstance(given, dict):
        given = next((given[name] for name in (f"{i},{j}", f"{i}", "") if name in given), None)
    return arb_mat(size, 1) if given is None and key != "z" else matrix(given, size)


def edges(problem, stages, t):
    """Yield modes i, j that can follow each other at t, t + 1, the box of (x, u) and that of x at t + 1."""
    for i, (box, image) in stages[t].modes.items() if stages and t < problem.T else ():
        last = {0: (stages[t + 1].box, None)}
        for j, (beyond, _) in (stages[t + 1].modes if t + 1 < problem.T else last).items():
            if meet(image, beyond[: problem.n]):
                yield i, j, box, beyond[: problem.n]
    if stages and t == problem.T:
        yield 0, 0, stages[t].box, None


def dual_bound(problem, lines, stages, normal):
    """Return a lower bound on the cost of the trajectories of a node."""
    n, value, given = problem.n, ZERO, {}
    spend(problem.T * STAGE)
    slopes = [arb_mat(len(lower), 1) for lower in problem.lower]
    while "signal" in lines.ahead:
        line = lines.take("signal values")
        i = integer(line["signal"], 0, n + problem.m - 1)
        require(i in problem.stops, "this component has no stop band")
        for t, one in enumerate(problem.removed(i, matrix(line["values"], problem.stops[i][0]).entries())):
            slopes[t][i, 0] += one
    while "multiplier" in lines.ahead:
        line = lines.take("multiplier values", "frequency")
        index = integer(line["multiplier"], 0, len(problem.terms) - 1)
        given.setdefault(index, []).append((line.get("frequency"), line["values"]))
    for index, multipliers in given.items():
        conjugate, pairs = problem.terms[index].conjugate(multipliers, normal)
        value -= conjugate
        for multiplier, t, i, c in ((multiplier, *entry) for multiplier, row in pairs for entry in row):
            slopes[t][i, 0] += multiplier * c
    eta, ahead, after = arb_mat(n, 1), {}, {0: ZERO}
    for t in range(problem.T, -1, -1):
        maybe = " mu eta" * (t > 0) + " region image" * (t < problem.T) + " vertex" * (0 < t < problem.T)
        line = lines.take("t z", maybe)
        integer(line["t"], t, t)
        eta, ahead, after = stage_bound(problem, stages, line, slopes[t], normal, (eta, ahead, after))
    return (value - largest(-one for one in after.values())).lower()


def stage_bound(problem, stages, line, slope, normal, later):
    """Return eta_{t-1}, v_{t-1} of each mode, and the least cost from t on of each mode, from those at t + 1."""
    t, n, (eta, ahead, after), found = line["t"], problem.n, later, {}
    pairs, cost, size, given = list(edges(problem, stages, t)), problem.costs[t], slope.nrows(), "eta" in line
    require(given or t == 0 or len(pairs) < 2, "eta is needed where several modes are possible")
    before, mu = (matrix(line[key], n) if key in line else arb_mat(n, 1) for key in ("eta", "mu"))
    vertex = {int(i): matrix(one, n) for i, one in line.get("vertex", {}).items()}
    for i, j, box, beyond in pairs:
        spend(size * (8 + 2 * n))
        z, linear, bound = pick(line, "z", i, j, size), slope, after.get(j, INFINITY)
        if t < problem.T:
            mode, image = problem.modes[i][t], pick(line, "image", i, j, n)
            region, e = pick(line, "region", i, j, mode["h"].nrows()), eta + ahead.get(j, arb_mat(n, 1)) + image
            require(all(one >= 0 for one in region.entries()), "a negative multiplier of a region")
            linear = linear - mode["map"].transpose() * e + mode["rows"].transpose() * region
            bound += total((c * x).lower() for c, x in zip(image.entries(), beyond) if not c.is_zero())
            bound -= (e.transpose() * mode["d"])[0, 0] + (region.transpose() * mode["h"])[0, 0]
            linear += arb_mat(size, 1, vertex.get(i, arb_mat(n, 1)).entries() + [ZERO] * problem.m)
        at_z, gradient = quadratic(cost, z) if normal else (ZERO, arb_mat(size, 1))
        gradient += linear
        if t > 0:
            rest = [ZERO] * (size - n)
            defined = arb_mat(n, 1, gradient.entries()[:n])
            before = before if given else -defined - mu
            linear += arb_mat(size, 1, before.entries() + rest)
            in_x = defined + before if given else -mu
            gradient = arb_mat(size, 1, in_x.entries() + gradient.entries()[n:])
        lower = [a.max(b.lower()) for a, b in zip(problem.lower[t], box)]
        upper = [a.min(b.upper()) for a, b in zip(problem.upper[t], box)]
        hessian = cost["hessian"] if normal else arb_mat(size, size)
        bound += at_z + (linear.transpose() * z)[0, 0]
        bound += charge(gradient.entries(), hessian, z.entries(), lower, upper)
        found[i] = -largest([-bound], -found.get(i, INFINITY))
    return before, vertex, found


def narrow(problem, level):
    """Cut the bounds to those of trajectories that cost less than a level: no part of the cost is ever negative."""
    for cost in once(problem.costs):
        require(all(c.is_zero() for c in cost["linear"].entries()), "a level, and a cost that may be negative")
        spend(3 * cost["hessian"].nrows() ** 3)
        bent = [least(cost["hessian"], i) for i in range(cost["hessian"].nrows())]
        radii = [(2 * level / c).sqrt() if c > 0 else INFINITY for c in bent]
        cost["sides"] = [[c + sign * r for c, r in zip(cost["center"].entries(), radii)] for sign in (-1, 1)]
    for t, (cost, low, high) in enumerate(zip(problem.costs, problem.lower, problem.upper)):
        lower, upper = cost["sides"]  # a side without a bound gets one, which no trajectory of the level misses
        problem.lower[t] = [a.max(b.min(c).lower()) for a, b, c in zip(low, lower, high)]
        problem.upper[t] = [c.min(b.max(a).upper()) for a, b, c in zip(low, upper, high)]
        pairs = zip(problem.lower[t], problem.upper[t])
        problem.boxes[t] = [a.union(b) if (b - a).is_finite() else UNKNOWN for a, b in pairs]


def lower_bound(problem, lines):
    """Return a lower bound on the cost of all trajectories: the least of the leaves of a tree, or its level."""
    head, everything = lines.section("nodes", "reach", "level"), set(range(len(problem.modes)))
    forward, level = head["reach"], number(head["level"]) if "level" in head else INFINITY
    require(isinstance(forward, bool), "reach: expected true or false")
    if "level" in head:
        require(level > 0, "expected a level above zero")
        narrow(problem, level)
    nodes, children, bounds = [], {}, {}
    while "node" in lines.ahead:
        if "section" in lines.ahead:
            line = lines.section("dual", "node cost")
            index, normal = integer(line["node"], 0, len(nodes) - 1), integer(line["cost"], 0, 1)
            require(index not in bounds and index not in children, "it has children or a dual")
            bounds[index] = dual_bound(problem, lines, nodes[index], normal)
            require(normal or bounds[index] > 0, f"node {index} is not proven to be infeasible")
            bounds[index], nodes[index] = bounds[index] if normal else INFINITY, None
            continue
        line, index = lines.take("node parent t modes"), len(nodes)
        t, modes = integer(line["t"], 0, problem.T - 1), {integer(i, 0, max(everything)) for i in line["modes"]}
        before = [Stage(box[: problem.n], everything) for box in problem.boxes] if index == 0 else None
        root = (line["parent"], t, modes) == (None, 0, everything)
        require(integer(line["node"], index, index) or root, "not a root")
        if index:
            parent = integer(line["parent"], 0, index - 1)
            require(parent not in bounds and children.setdefault(parent, (t, set()))[0] == t, "another time, or a dual")
            children[parent][1].update(modes)
            before = nodes[parent]
        nodes.append(reach(problem, before, t, modes, forward) if before else None)
    for index, stages in ((index, stages) for index, stages in enumerate(nodes) if stages and index not in bounds):
        t, modes = children.get(index, (0, set()))
        require(set(stages[t].modes) <= modes, f"the children of node {index} do not cover it, or it has no dual")
    require(nodes, "expected a node")
    return -largest((-bound for bound in bounds.values()), -level)


# ------------------------------------------------------------ pulse trains


class Train:
    """Steps at m angles of a quarter, s_i = +-step at a_i, and I = 0 at its end; the cost is price (E + offset)."""

    def __init__(self, lines):
        fields = "name switches lowest highest orders step price offset dwells low high"
        head = self.head = lines.section("pulse train", fields)
        m = self.m = integer(head["switches"], 1, MOST_SWITCHES)
        self.lowest, self.highest = integer(head["lowest"], -MOST_LEVELS, 0), integer(head["highest"], 0, MOST_LEVELS)
        self.orders = [integer(k, 1, MOST_ORDER) for k in head["orders"]]
        require(all(k % 2 for k in self.orders) and len({*self.orders}) == len(self.orders), "expected odd orders")
        self.step, self.price, self.offset = (number(head[key]) for key in ("step", "price", "offset"))
        self.dwells, K = matrix(head["dwells"], m + 1).entries(), len(self.orders)
        self.low, self.high = (matrix(head[key], K, infinite=True).entries() for key in ("low", "high"))
        require(self.step > 0 and self.price > 0 and all(d >= 0 for d in self.dwells), "a step, price or dwell below 0")
        require(all(low <= high for low, high in zip(self.low, self.high)), "empty limits of an amplitude")
        self.quarter, self.most = arb.pi() / 2, self.step * max(self.highest, -self.lowest)

    def summary(self):
        yield ", ".join(f"{key}: {value!r}" for key, value in self.head.items())

    def signs(self, given, *allowed):
        require(isinstance(given, list) and len(given) == self.m, f"expected {self.m} signs")
        require(all(type(sign) is int and sign in allowed for sign in given), f"signs: expected {allowed}")
        return given

    def amplitudes(self, signs, a):
        """Return b_k, its slopes and its second derivatives by each angle, for each order."""
        spend(SINE * self.m * len(self.orders))
        values, slopes, bends, factor = [], [], [], 4 * self.step / arb.pi()
        for k in self.orders:
            turns = [(k * x).sin_cos() for x in a]
            values.append(total(s * cosine for s, (_, cosine) in zip(signs, turns)) * factor / k)
            slopes.append([-s * sine * factor for s, (sine, _) in zip(signs, turns)])
            bends.append([-s * cosine * factor * k for s, (_, cosine) in zip(signs, turns)])
        return values, slopes, bends

    def energy(self, signs, a):
        """Return E of angles in order, and its slopes."""
        spend(20 * self.m**2)
        q, c, factor, E, slopes = self.quarter, [self.quarter - x for x in a], 8 * self.step**2 / arb.pi(), ZERO, []
        for i, x in enumerate(c):  # angles before have a larger c
            before = total(signs[j] * (c[j] * q - (x * x + c[j] * c[j]) / 2) for j in range(i))
            after = total(signs[j] * c[j] for j in range(i + 1, self.m)) * (q - x) + signs[i] * x * (q - x)
            slopes.append(-factor * signs[i] * (before + after))
            own = x * x * q - 2 * x**3 / 3
            pairs = total(signs[j] * x * (c[j] * q - x * x / 6 - c[j] * c[j] / 2) for j in range(i))
            E += factor * (own / 2 + signs[i] * pairs)
        return E, slopes

    def upper_bound(self, lines):
        """Return an upper bound on the cost of a train near the given angles that meets all limits.

        Dwells of ``least`` have their least values exactly, and amplitudes ``at`` a limit, by Krawczyk's operator: if
        it maps a box of the angles that ``move`` into itself, a zero is inside.
        """
        head, m, q = lines.section("point", "signs angles least at move"), self.m, self.quarter
        signs, given, least, moved = self.signs(head["signs"], 1, -1), matrix(head["angles"], m), head["least"], {}
        levels = [sum(signs[: i + 1]) for i in range(m)]
        require(all(self.lowest <= level <= self.highest for level in levels), "a level beyond its limits")
        require(len(least) == m + 1 and all(type(one) is bool for one in least), f"least: expected {m + 1} truths")
        equal = [(i, self.low[i] if side == "low" else self.high[i]) for i, side in enumerate(head["at"]) if side]
        move = [integer(i, 0, m - 1) for i in head["move"]]
        require(len(head["at"]) == len(self.orders), "at: expected a side, or none, of each amplitude")
        require(len(move) == len(equal), "as many angles as amplitudes at limits")

        def angles(leaders):
            a = []
            for i in range(m):
                a.append((a[-1] if i else ZERO) + self.dwells[i] if least[i] else leaders.get(i, given[i, 0]))
            for i in reversed(range(m)):
                if least[i + 1]:
                    a[i] = (a[i + 1] if i < m - 1 else q) - self.dwells[i + 1] if all(least[i + 1 :]) else a[i]
            return a

        def misses(leaders):
            values, slopes, _ = self.amplitudes(signs, angles(leaders))
            follow = [[j for j in range(i, m) if all(least[i + 1 : j + 1])] for i in move]
            rows = [[total(slopes[k][j] for j in group) for group in follow] for k, _ in equal]
            return arb_mat([[values[k] - limit] for k, limit in equal]), arb_mat(rows)

        require(not any(least[i] or all(least[i + 1 :]) for i in move), "an angle that moves is not free")
        if equal:
            centre, box = {i: given[i, 0] for i in move}, arb(2) ** -NEWTON_BITS * UNIT
            miss, slopes = misses(centre)
            inverse = slopes.mid().inv().mid()
            _, slopes = misses({i: x + box for i, x in centre.items()})
            rest = arb_mat(len(move), len(move), ONE) - inverse * slopes  # ONE on the diagonal
            steps = (rest * arb_mat([[box]] * len(move)) - inverse * miss).entries()
            require(all(box.contains_interior(one) for one in steps), "no angles near these have the amplitudes")
            moved = {i: x + one for (i, x), one in zip(centre.items(), steps)}
        a = angles(moved)
        ends = zip([ZERO, *a], [*a, q], self.dwells, least)
        require(all(exact or y - x >= d for x, y, d, exact in ends), "a dwell is below its least")
        require(not all(least), "no angle is free")
        for i, b in enumerate(self.amplitudes(signs, a)[0]):
            inside = head["at"][i] or (self.low[i] <= b and b <= self.high[i])
            require(inside, f"harmonic {self.orders[i]} is not within its limits")
        return self.price * (self.energy(signs, a)[0] + self.offset)

    def lower_bound(self, lines):
        """Return the level of the cost that no train is below: each part is narrowed or divided until it has none."""
        level, whole = number(lines.section("nodes", "level")["level"], infinite=True), (fmpq(0), fmpq(1))
        E, parts = level / self.price - self.offset, [[(*whole, 0)] * self.m]
        while parts:
            part = parts.pop()
            if "lattice" in lines.ahead:
                line = lines.take("lattice whole prices", "low high signs")
                N, inside = integer(line["lattice"], 1, MOST_LATTICE), None
                if "low" in line:
                    low, high = ([integer(i, 0, N) for i in line[side]] for side in ("low", "high"))
                    signs = self.signs(line["signs"], -1, 0, 1)
                    require(len(low) == len(high) == self.m, f"low, high: expected {self.m} indices")
                    inside = [*zip(low, high, signs)]
                    ends = [(max(p, fmpq(a, N)), min(q, fmpq(b, N))) for (p, q, _), a, b in zip(part, low, high)]
                    parts.append([(*both, s or old) for both, s, (_, _, old) in zip(ends, signs, part)])
                least = self.least_on_lattice(part, N, line, E, inside)
                require(least >= E, f"trains may cost less: the lattice has {least.str(17)} for {E.str(17)}")
            elif "sums" in lines.ahead:
                self.require_no_train(part, lines.take("sums weights"))
            elif "split" in lines.ahead:
                i = integer(lines.take("split")["split"], 0, self.m - 1)
                low, high, sign = part[i]
                halves = [(low, high, s) for s in (-1, 1)]
                halves = halves if sign == 0 else [((low + high) / 2, high, sign), (low, (low + high) / 2, sign)]
                parts += [[*part[:i], half, *part[i + 1 :]] for half in halves]
            else:
                line = lines.take("optimum prices forces")
                bound = self.least_by_curvature(part, line)
                require(bound >= E, f"trains may cost less: by curvature {bound.str(17)}, not {E.str(17)}")
        return level

    def least_on_lattice(self, part, N, line, E, inside):
        """Return a lower bound on the energy of trains of a part with an angle or a sign outside of another part.

        Trains with an energy of E or more are left out: of the others, the integral is in a tube around -R.
        """
        m, s, q, h = self.m, self.step, self.quarter, self.quarter / N
        r, whole, ends = matrix(line["prices"], len(self.orders)).entries(), line["whole"], ZERO
        for price, k, low, high in zip(r, self.orders, self.low, self.high):
            ends += ZERO if price.is_zero() else 2 * price * (low if price > 0 else high) / k
        require(isinstance(whole, bool) and ends.is_finite(), "a price of an amplitude without a limit")
        hold = self.holds(h)
        apart = not whole and all(d > h for d in self.dwells[1:-1])
        hold = hold if whole else [hold[0], *(max(i - 1, 0) for i in hold[1:-1]), hold[-1]]
        chains = [[0]]
        for j in range(1, m):  # angles of one cell, or moved together
            far = apart or part[j][0] - part[j - 1][1] >= fmpq(hold[j] + 1 if whole else 1, N)
            chains = [*chains, [j]] if far else [*chains[:-1], [*chains[-1], j]]
        low, high = self.ranges(part, N, hold)
        most = (E - ends + total(price * price for price in r)).max(ZERO)  # of L_r
        steepest = self.most + total(abs(price) * k for price, k in zip(r, self.orders))
        width = (3 * arb.pi() / 4 * steepest * most).root(3).min(q * self.most + total(map(abs, r))).upper()
        spread = total(len(one) * (part[j][1] * q + h).min(q) for one in chains for j in one)
        loss = h * h * s / arb.pi() * (s * spread + m * width)
        spend(SINE * len(r) * (2 + sum(max(b - a, 0) for a, b in zip(low, high))))
        steps, waves = {i for a, b in zip(low, high) for i in range(a, b + 1)}, {}
        for i in steps:
            turns = [price * (k * i * h).cos() for price, k in zip(r, self.orders)]
            middle, bent = total(turns), total(turn / k**2 for turn, k in zip(turns, self.orders))
            lower, upper = ((middle + side * width) / (h * s) + side * m for side in (-1, 1))
            first, last = (int(end.floor().unique_fmpz()) for end in (lower.lower(), upper.upper()))
            waves[i] = first, last, 8 * s / arb.pi() * bent, i * h
        least, error = self.recursion(part, N, low, high, hold, waves, inside)
        return INFINITY if least == math.inf else arb(least) - error - loss + ends

    def holds(self, h):
        """Return the whole steps h in each dwell."""
        return [int((d / h).lower().floor().unique_fmpz()) for d in self.dwells]

    def ranges(self, part, N, hold):
        """Return the first and the last index on a lattice of each angle of a part, with its dwells."""
        low, high = [int((a * N).floor()) for a, _, _ in part], [int((b * N).ceil()) for _, b, _ in part]
        for i in range(self.m):
            low[i] = max(low[i], (low[i - 1] if i else 0) + hold[i])
            high[-1 - i] = min(high[-1 - i], (high[-i] if i else N) - hold[-1 - i])
        return low, high

    def levels(self, part):
        """Return the levels that trains of a part may have after each number of switches."""
        found = [{0}]
        for _, _, sign in part:
            after = {v + t for v in found[-1] for t in (1, -1) if sign != -t}
            found.append({v for v in after if self.lowest <= v <= self.highest})
        return found

    def require_no_train(self, part, line):
        """Show that a weighted sum of amplitudes misses its limits for all trains of a part.

        One offset for all angles moves a train to the lattice, and the mean of the sum by h^2/8 times its bends.
        """
        N, m, inf = integer(line["sums"], 1, MOST_LATTICE), self.m, math.inf
        w, h, factor = matrix(line["weights"], len(self.orders)).entries(), self.quarter / N, 4 * self.step / arb.pi()
        hold = self.holds(h)
        low, high = self.ranges(part, N, hold)
        ends = [one * (up if one > 0 else down) for one, down, up in zip(w, self.low, self.high) if not one.is_zero()]
        error = rounding(2 * m + 2, m * factor * total(map(abs, w)))
        spend(SINE * len(w) * (N + 1) + 4 * m * N * len(self.levels(part)[-1]))
        waves = [
            float(factor * total(one * (k * i * h).cos() / k for one, k in zip(w, self.orders))) for i in range(N + 1)
        ]
        rest = {v: [0.0] * (N + 1) for v in self.levels(part)[m]}
        for c in reversed(range(m)):
            before = {v: [inf] * (N + 1) for v in self.levels(part)[c]}
            for v, costs in before.items():
                ways = [(t, rest[v + t]) for t in (1, -1) if part[c][2] != -t and v + t in rest]
                for i in range(high[c], low[c] - 1, -1):
                    costs[i] = min((t * waves[i] + after[i + hold[c + 1]] for t, after in ways), default=inf)
                for i in range(N - 1, -1, -1):
                    costs[i] = min(costs[i], costs[i + 1])
            rest = before
        least, bent = rest[0][0], factor * m * h * h / 8 * total(abs(one) * k for one, k in zip(w, self.orders))
        require(least == inf or arb(least) - error - bent > total(ends), "trains may meet the limits of amplitudes")

    def recursion(self, part, N, low, high, hold, waves, inside):
        """Return the least E - 2 sum r_k b_k / k of trains of the lattice with a switch outside, and its rounding.

        The cost to go from i h, in a level v with -I = n h s, is sought with the integral from 0 along n + v i added:
        it stays the same while the level lasts, and a switch from v to v + t adds what is linear in n.
        """
        m, h, factor, levels = self.m, self.quarter / N, 4 * self.step**2 / arb.pi(), self.levels(part)
        last = {v: double(factor * v * v * self.quarter**3 / 3) for v in levels[m]}
        rows, size = {v: [(N, v * N, [end], [math.inf])] for v, end in last.items()}, max(last.values(), default=0.0)
        for c in reversed(range(m)):
            before, most = {}, 0.0
            for v in levels[c]:
                arms = [(t, Costs(rows[v + t])) for t in (1, -1) if part[c][2] != -t and rows.get(v + t)]
                before[v] = []
                for i in range(high[c], low[c] - 1, -1) if arms else ():
                    first, end, bent, theta = waves[i]
                    first = max(first, min(arm.first - (v + t) * i for t, arm in arms))
                    end = min(end, max(arm.first + arm.size - 1 - (v + t) * i for t, arm in arms))
                    if first > end:
                        continue
                    spend(LATTICE * (end - first + 1) * len(arms), 1)
                    least, (low_end, high_end, sign) = None, inside[c] if inside else part[c]
                    for t, arm in arms:
                        arm.add(i + hold[c + 1])
                        slope = double(-t * factor * h * theta**2)
                        constant = double(-factor * theta**3 * (2 * v * t + 1) / 3 - t * bent)
                        most = max(most, abs(slope) * max(abs(first), abs(end)) + abs(constant))
                        out = not inside or sign == -t or (i <= low_end and fmpq(low_end, N) > part[c][0])
                        out = out or (i >= high_end and fmpq(high_end, N) < part[c][1])
                        costs = arm.window(first + (v + t) * i, end - first + 1)[: 1 if out else 2]
                        costs = [[z + (slope * n + constant) for n, z in enumerate(row, first)] for row in costs]
                        both = costs[0], costs[-1]
                        least = both if least is None else [list(map(min, a, b)) for a, b in zip(least, both)]
                    before[v].append((i, first + v * i, *least))
            rows, size = before, size + most
        found = min((min(chosen) for _, _, _, chosen in rows[0]), default=math.inf)
        return found, rounding(6 * m + 6, arb(size))

    def least_by_curvature(self, part, line):
        """Return a lower bound on the energy of trains of a part by the Lagrangian at angles, where it is convex."""
        m, q, K = self.m, self.quarter, len(self.orders)
        signs, c = [sign for _, _, sign in part], matrix(line["optimum"], m).entries()
        price, force = matrix(line["prices"], K).entries(), matrix(line["forces"], m + 1).entries()
        require(all(signs) and all(nu >= 0 for nu in force), "a sign that is free, or a force below zero")
        E, slopes = self.energy(signs, c)
        b, by_angle, bends = self.amplitudes(signs, c)
        x = [after - before - d for before, after, d in zip([ZERO, *c], [*c, q], self.dwells)]
        require(all(y - z >= 0 for y, z in zip(c[1:], c)), "the angles are not in order")
        sides = [[q * low - y, q * high - y] for (low, high, _), y in zip(part, c)]
        far, M0 = [abs(low).max(abs(high)) for low, high in sides], [[ZERO] * m for _ in c]
        value, G = E, list(slopes)
        for r, row, bend, b_k, low, high, k in zip(price, by_angle, bends, b, self.low, self.high, self.orders):
            fixed, along = low == high, total(abs(g) * d for g, d in zip(row, far))
            over = b_k - (low if fixed or r < 0 else high)
            require(fixed or r.is_zero() or over.is_finite(), "a price of an amplitude without a limit")
            over = ZERO if r.is_zero() and not fixed else over
            steep = self.step * 4 / arb.pi() * k  # the largest second derivative of b_k
            most = along + steep * total(d * d for d in far) / 2
            stiff = ONE if fixed else ZERO if r.is_zero() else (abs(r) / (abs(over) + most)).min(ONE)
            value += r * over - 2 * stiff * abs(over) * most
            wide = stiff * total((steep * d) ** 2 for d in far) / 2
            for i in range(m):
                G[i] += r * row[i]
                M0[i][i] += r * bend[i] - abs(r) * steep * k * k * far[i] ** 2 / 12 - wide
                for j in range(m):
                    M0[i][j] += stiff * row[i] * row[j]
        for j, (nu, gap) in enumerate(zip(force, x)):
            ends = [i for i in (j - 1, j) if 0 <= i < m]  # x_j = a_j - a_{j-1} - d_j
            along = total(far[i] for i in ends)
            stiff = ZERO if nu.is_zero() else nu / (abs(gap) + along)
            value -= nu * gap + 2 * stiff * abs(gap) * along
            for i in ends:
                G[i] -= nu * (1 if i == j else -1)
                for other in ends:
                    M0[i][other] += 2 * stiff * (1 if i == other else -1)
        value -= total(abs(g) * d for g, d in zip(G, far))
        spend(CURVATURE * m**3 * 2**m)
        for corner in itertools.product(*sides):
            a, rows = [y + d / 3 for y, d in zip(c, corner)], [list(row) for row in M0]
            for i in range(m):
                for r, sine, k in zip(price, by_angle, self.orders):  # b_k'' at c + d / 3
                    rows[i][i] -= r * k * k * sine[i] * corner[i] / 3
                rows[i][i] += 8 * self.step**2 / arb.pi() * (2 * a[i] - q)
                for j in (j for j in range(m) if j != i):
                    both = 8 * self.step**2 / arb.pi() * signs[i] * signs[j]
                    rows[i][j] += both * a[min(i, j)]
                    rows[i][i] -= both * (q - a[max(i, j)])
            while rows:
                (pivot, *rest), rows = rows[0], rows[1:]
                require(pivot > 0, "the Lagrangian is not convex over the part")
                rows = [[z - row[0] / pivot * y for z, y in zip(row[1:], rest)] for row in rows]
        return value


class Costs:
    """The least costs on lines n + v i, of rows (i, first line, costs, costs of trains outside) from larger i on."""

    def __init__(self, rows):
        self.rows, self.first = iter(rows), min(row[1] for row in rows)
        self.size = max(row[1] + len(row[2]) for row in rows) - self.first
        self.least, self.ahead = ([math.inf] * self.size, [math.inf] * self.size), next(self.rows)

    def add(self, start):
        """Take in the rows from ``start`` on."""
        while self.ahead is not None and self.ahead[0] >= start:
            at = self.ahead[1] - self.first
            for values, row in zip(self.least, self.ahead[2:]):
                values[at : at + len(row)] = map(min, values[at : at + len(row)], row)
            self.ahead = next(self.rows, None)

    def window(self, first, count):
        """Return the costs on lines from ``first`` on, of all trains and of those outside; infinite beyond."""
        at = first - self.first
        before = min(max(-at, 0), count)
        parts = [values[max(at, 0) : max(at + count, 0)] for values in self.least]
        return [[math.inf] * before + part + [math.inf] * (count - before - len(part)) for part in parts]


# ------------------------------------------------------------ the whole proof


def check(file, say=print, limit=math.inf):
    """Return (lb, ub) that a proof proves, exact balls, within a limit of work; both infinite without a trajectory."""
    Work.done, Work.most, Work.words = 0.0, limit, 1
    try:
        lines = Lines(file)
        head = lines.take("format version bits")
        require(head["format"] == "lfo-proof" and integer(head["version"], 1, 1), "another format or version")
        ctx.prec, lines.hash = integer(head["bits"], 64, MOST_BITS), hashlib.sha256()
        Work.words = 1 + ctx.prec // 64
    except Exception as error:
        raise ValueError(f"not a proof: {error!r}") from error
    try:
        train = lines.ahead.get("section") == "pulse train"
        problem = Train(lines) if train else Problem(lines)
        bounds = (Train.upper_bound, Train.lower_bound) if train else (upper_bound, lower_bound)
        for one in (*problem.summary(), f"sha256 of the section PROBLEM: {lines.hash.hexdigest()}"):
            say(one)
        claim = lines.section("claim", "lower upper")
        claimed = [number(claim[side], infinite=True) for side in ("lower", "upper")]
        upper = bounds[0](problem, lines).upper() if lines.ahead.get("section") == "point" else INFINITY
        lower = bounds[1](problem, lines)
        lines.section("end", "")
        require(lines.text == b"", "there is something behind the end")
        shown = f"{lower.str(17)} .. {upper.str(17)}"
        require(claimed[0] <= lower <= upper <= claimed[1], f"{shown} is proven, which does not imply the claim")
    except Exception as error:
        raise Failed(f"line {lines.at}: {error or type(error).__name__}") from error
    return lower, upper


def decimal(exact, rounding):
    """Return an exact ball as a decimal number of 17 digits, rounded one way."""
    if not exact.is_finite():
        return "inf" if exact > 0 else "-inf"
    size = abs(int(exact.man_exp()[1]))
    require(size < 2**24, "a bound is too large or too small to be printed")
    spend((size // 256) ** 2, 1)
    ends, context = rational(exact), Context(17, rounding, MIN_EMIN, MAX_EMAX)
    return str(context.divide(Decimal(int(ends.p)), Decimal(int(ends.q))))


def main():
    """Check the file that is named on the command line."""
    match sys.argv[1:]:
        case [name, "--limit", limit] | ["--limit", limit, name] if re.fullmatch(r"\d+(\.\d*)?(e\d{1,3})?", limit):
            most = float(limit)
        case [name] if name not in ("-h", "--help"):
            most = None
        case given:
            print(__doc__)
            return 0 if len(given) == 1 else 2
    if hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        with open(name, "rb") as file:
            size = os.fstat(file.fileno()).st_size
            lower, upper = check(file, limit=LEAST_WORK + WORK_BY_BYTE * size if most is None else most)
        interval = f"VERIFIED {decimal(lower, ROUND_FLOOR)} {decimal(upper, ROUND_CEILING)}"
    except Failed as failed:
        print(f"FAILED {failed}")
        return 1
    except (OSError, ValueError) as error:
        print(f"lfo_check.py FILE: {error}", file=sys.stderr)
        return 2
    print("INFEASIBLE" if lower == INFINITY else interval)
    return 0


if __name__ == "__main__":
    sys.exit(main())
