SUFFIXES = (".png", ".pdf", ".svg")
