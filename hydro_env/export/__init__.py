"""The rig and its controllers in other tools: FMU, C99, Structured Text, ONNX.

c_printer        typed statements (`hydro_env.ir`) as C
plant_source     the rig in C, from the kernel's generated module
fmu              a Functional Mock-up Unit around it
symbols, tracing a controller's own Python, run on symbols, as a program
copies           copies of its modules, in which it may be run on symbols
schedule         the program as typed statements, in the order in which it is computed; compiled functions that it calls
structured_text  the program in Structured Text
templates        what is the same in all sources
onnx             networks as ONNX graphs
controllers      from a controller's name to files, and its program in C
"""
