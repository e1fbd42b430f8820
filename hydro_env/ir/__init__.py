"""The one intermediate form of what is compiled: typed expressions and statements, which several languages print.

nodes   expressions, statements and functions
reader  reads them from the Python of compiled functions and generated modules

The kernel prints them as vector instructions (`plant.kernel.vector_ir`), the export as C and Structured Text (`export`), which
also makes programs of them from controllers that are run on symbols.
"""
