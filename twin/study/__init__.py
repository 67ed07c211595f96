"""Puts the parts together: the only folder that sees world, sense and judge.

==========================  ======================================================================
a scene                     `recipe`, `schema`, `doubts`
a sensor made from it       `sensor`
one run                     `run`
a calibration               `calibrate`, `fitted_design`
recorded frames             `frames`, `recorded`, `intrinsics`
by hand, in a loop          `live`, `environment`, `gym`, `ros`
to look at                  `view`
many runs                   `dataset`, `sweep`, `reproduce`, and `batch` for what they share
a file, or this machine     `check`
==========================  ======================================================================
"""
