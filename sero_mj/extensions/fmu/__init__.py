"""Controllers that are Functional Mock-up Units, exported by Simulink, Dymola or OpenModelica.

In: an FMU file. Out: the controller kind `fmu`.
Open first: `fmu.py`.
"""
