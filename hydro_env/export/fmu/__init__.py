"""The rig as a Functional Mock-up Unit.

description   modelDescription.xml of FMI 2.0 and 3.0, with the units of the catalogue in base units
build         the C compiler of this machine; sources, binary and description packed as one file
fmi2.c fmi3.c what the standard asks for, around the plant's own source (`hydro_env.export.plant_source`)
"""
