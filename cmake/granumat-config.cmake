# find_package(granumat) gives
#   granumat::core   many points in one call, for C and through bind(c): granumat.h
#   granumat::umat   umat_ and sdvini_, or granumat_ for a job with an umat of its own; static
#   granumat::GRANUMAT   the same as a shared library, with the alias GRANUMAT and the user-defined soil model user_mod_
include(${CMAKE_CURRENT_LIST_DIR}/granumat-targets.cmake)
