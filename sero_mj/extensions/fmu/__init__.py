"""Controllers as Functional Mock-up Units: registers the controller kind `fmu`."""
