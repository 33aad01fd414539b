"""Files on disk that are whole or absent, carry a checksum, and have one writer at a time.

In reading order:

    disk              the operations that change what is on disk, where tests put faults in
    store             whole files with their digest, JSON, CSV, locks, `keep`
    hdf5              arrays with one header: which kind of file, made of what, when, in which time
    samples           data sets, harvests, settled reference states
    tables            tables of RVE answers, and of surface laws
    surrogates        surrogates and interrupted trainings
    c_source          a surrogate as C
    run_folder        the one life of a run in its folder: record, curves, checkpoint
    fields            fields over time for ParaView, of elements, particles and law points
    meshes            meshes that other programs made
    mesh_reader       the process that reads them
    gmsh_file         files of Gmsh
    abaqus_file       files of Abaqus
    plane_mesh        one kind of element in the plane, with named sides and regions
    labelled_image    images whose pixels have the numbers of their cells
    labelled_surface  surfaces whose vertices have them (PLY), as such images
"""
