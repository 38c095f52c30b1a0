"""Controllers that are Functional Mock-up Units, exported by Simulink, Dymola or OpenModelica.

The controller kind `fmu` runs an FMU file.
Open first: `fmu.py`.
"""
