"""Plant cells of particles: arrangements, pair lists, pair laws and their kernels.

In reading order: `tessellation`, `parameters`, `arrangement`, `reference_state` (where particles
are); `pair_lists` (who interacts with whom); `wall`, `contact`, `fluid`, `sph_kernel` (pair laws);
`tiles` (how arrays lie); `pairs`, `forces`; `block_pattern`, `jacobian`, `force_derivatives`.
"""
