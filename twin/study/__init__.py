"""Puts the parts together: the only folder that sees the world, the sensor's software and the judge.

==========================  ==========================================================================
a scene                     `recipe` (`recipe_tables`, `recipe_files`), `complaints`, `schema`, `check`
a sensor made from it       `sensor`, `actual`, `elastic`, `motion`, `sites`, `meshes`
one run                     `run`, `scored`, `touch`, `run_folder`
a calibration               `calibrate`, `calibration_presses`, `fitted`
recorded frames             `recorded`, `recorded_presses`, `frames`, `intrinsics`, `table_files`
by hand, in a loop          `live` (`loopback`), `environment`, `gym`, `ros`
to look at                  `view`, `film`
many runs                   `dataset`, `sweep`, `reproduce`, and `batch` for what they share
this machine                `doctor`
==========================  ==========================================================================
"""
