"""What worker processes are forked from: it has imported all that a measurement needs.

It has numba's tables, which the first compiled function takes 0.4 s to fill, but not the job with its onnxruntime,
which has a thread.
"""

import service.results.fields  # noqa: F401 - to have both imported
from pipeline.rig.design import nominal_rig

nominal_rig().cameras[0].rays([[0, 0]])
