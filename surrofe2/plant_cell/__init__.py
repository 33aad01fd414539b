"""Plant cells of particles: arrangements, pair lists, pair laws and their kernels.

In reading order: `tessellation`, `parameters`, `arrangement`, `reference_state` (where particles
are); `tiles`, `block_pattern` (how arrays and matrices lie); `neighbours` (who interacts with
whom); `pair_laws`; `forces`, `derivatives`.
"""
