"""Plant cells of particles: arrangements, pair lists, pair laws and their kernels.

In reading order: `tessellation`, `parameters`, `measurements`, `arrangement`, `outlined` (where
particles are); `block_matrices`, `neighbours` (who interacts with whom); `pair_laws`, `pair_sums`;
the terms of the forces, each with its energy and its derivatives (`central_pairs`, `sph_fluid`,
`uniform_fluid`), and their sums, `forces` and `derivatives`.
"""
