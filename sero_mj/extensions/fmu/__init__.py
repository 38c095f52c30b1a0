"""Controllers as Functional Mock-up Units, as Simulink, Dymola and OpenModelica export them.

In: an FMU file. Out: the controller kind `fmu`.
Open first: `fmu.py`.
"""
