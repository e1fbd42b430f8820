"""The rig and its controllers in other tools: FMU, C99, Structured Text, ONNX.

translate        compiled functions as C, statement by statement
plant_source     the rig in C, from the kernel's generated module
fmu              a Functional Mock-up Unit around it
symbols, tracing a controller's own Python, run on symbols, as a program
kernels          the compiled functions that it calls
schedule         the order in which the program is computed
c_code, structured_text  the program in C and in Structured Text
onnx             networks as ONNX graphs
controllers      from a controller's name to files
compiler         the C compiler of this machine
"""
