"""What every room stands on.

In reading order:

    public_names     what packages offer, loaded on request
    arrays           what annotations call arrays
    units            µm, µs, ng and what follows from them
    errors           what is raised, one sentence each
    locks            flock, where the file system has it
    settings         bounds of settings, stated once at the field
    interruption     signals
    versions         of all that is used, and the machine
    compilation      numba's flags, where compiled kernels are kept, threads of BLAS
    simd             eight lanes of numbers in kernels
    tensors          polar inputs of (F, Ḟ), measure of errors
    square_symmetry  the eight symmetries of a square sample
    sampling         which (F, Ḟ) are sampled
"""
