"""Plant cells of particles: arrangements, pair lists, pair laws and their kernels.

In reading order: `tessellation`, `parameters`, `arrangement` (where particles are);
`block_matrices`, `neighbours` (who interacts with whom); `pair_laws`, `forces`, `derivatives`.
"""
