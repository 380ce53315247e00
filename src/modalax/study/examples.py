"""A complete example of a study file of each kind; all but the bootstrap need no other file."""

NOISE = """\
# How far do the modes scatter with the noise, are they biased, and do their error bars hold?
kind = "noise"
draws = 1000                   # fits, each with another draw of the noise
seed = 1                       # another seed, other draws
# chunk = 16                   # draws computed and stored together; chosen if not given
# memory_mb = 500              # memory that a chunk may take

[system]
simulation = "five_dof"        # the built-in system, or a file with M, C, K or modes
band = [20.0, 70.0]            # Hz
step = 0.1                     # distance of the frequency lines in Hz
inputs = ["1"]                 # DoFs where the force acts; the first if not given
# outputs = ["1", "3"]         # DoFs that are measured; all if not given
form = "receptance"            # or mobility, accelerance
noise = 0.02                   # as a fraction of the reference
noise_reference = "rms"        # of each channel's rms; or peak, local

[fit]
refine = true                  # maximum likelihood, with standard deviations; false: many diagrams at once
# method = "lscf"              # or plscf, lsce, fdpi; chosen if not given
# order = 20                   # highest order of the diagram; chosen if not given
"""

BOOTSTRAP = """\
# How far do the modes of this measurement scatter, by its own repeats or its own noise?
kind = "bootstrap"
draws = 500
seed = 1

[data]
file = "measurement.npz"       # any file of FRFs, seen from here; modalax demo --out DIR makes one
# band = [20.0, 70.0]          # Hz; all lines if not given
run = 1                        # run to draw from where noise is drawn
resample = "auto"              # runs (repeats at one force), variance (noise on the fitted model), or auto

[fit]
refine = true
"""

PARAMETER = """\
# How do bias and scatter depend on settings of the test and the fit?
kind = "parameter"
draws = 50                     # of each combination
seed = 1

[system]
simulation = "five_dof"
band = [20.0, 70.0]
step = 0.1
inputs = ["1"]

[fit]
refine = false
method = "lscf"

[vary]                         # every combination of these; any key of [system] and [fit]
"system.noise" = [0.005, 0.01, 0.02]
"fit.order" = [10, 20, 30]
"""

DIAGNOSIS = """\
# From which size on is a hidden effect named rightly?
kind = "diagnosis"
draws = 20                     # of each size
seed = 1

[system]
simulation = "five_dof"
band = [20.0, 70.0]
step = 0.25
inputs = ["1"]
noise = 0.02
# force = [1.0, 3.0, 6.0]      # force amplitudes in N, a run for each; joints need them

[hidden]
cause = "added_mass"           # an element, a fault of a channel, or the law of a joint
where = ["3"]
sizes = [0.0, 0.01, 0.03]      # in the unit of its parameter; 0 shows false alarms
# parameter = "slip_force"     # of a joint's law: what the sizes are values of
# fixed = { k = 2e4 }          # of a joint's law: its other parameters

[diagnose]
# causes = ["added_mass"]      # what to look for; the whole catalogue if not given
"""

FUNCTION = """\
# Any function of a seed, which gives a number, an array, or a dictionary of such: def one_draw(seed, noise=0.02): ...
# A parameter called number, if it has one and it is not given below, is the number of the draw, from 0.
kind = "function"
draws = 1000
seed = 1
function = "modalax.study.half_power:half_power"  # module:function; a module beside this file is found as well
# vmap = true                  # the function takes a JAX key, and all draws of a chunk run as one program

[parameters]                   # further arguments of the function
noise = 0.02
"""

EXAMPLES = {
    "noise": NOISE, "bootstrap": BOOTSTRAP, "parameter": PARAMETER, "diagnosis": DIAGNOSIS, "function": FUNCTION,
}  # fmt: skip
