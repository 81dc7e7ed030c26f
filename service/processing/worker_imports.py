"""Imports of the server that worker processes are forked from: what a measurement needs.

Calling a compiled function fills numba's tables, which takes 0.4 s. The job itself is not imported, because its
onnxruntime has a thread, which must not exist when processes are forked.
"""

import drivers.files.recording  # noqa: F401 - for its effect: each worker would take 0.3 s for these four
import pipeline.particle
import pipeline.refinement  # noqa: F401 - as above
import service.results.fields  # noqa: F401 - as above
from pipeline.rig.design import nominal_rig

nominal_rig().cameras[0].rays([[0, 0]])
