"""Arrays, tensors, units, errors, settings and compilation, which all other rooms use.

In reading order:

    public_names     what packages offer, loaded on request
    arrays           what annotations call arrays
    units            µm, µs, ng and what follows from them
    errors           what is raised, one sentence each
    locks            flock, where the file system has it
    settings         bounds of settings, stated once at the field
    launcher         whether mpiexec or srun started the process
    interruption     signals
    versions         of all that is used, and the machine
    environment      cores, and what the command line sets in its process
    clock            clocks that stand while kernels are compiled
    kernel_cache     where compiled kernels are kept, by their sources
    machine_code     made once of each kernel, the same bits in every process
    compilation      numba's flags, threads of BLAS
    simd             eight lanes of numbers in kernels
    tensors          polar inputs of (F, Ḟ), measure of errors
    square_symmetry  the eight symmetries of a square sample
    sampling         which (F, Ḟ) are sampled
"""
