"""Kernels: an expression graph of a casadi.Function, C written from it, and native code cached from that."""
