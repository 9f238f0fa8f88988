# find_package(granumat) gives
#   granumat::core   many points in one call, for C and through bind(c): granumat.h
#   granumat::umat   umat_ and sdvini_, static
#   granumat::GRANUMAT   the same as a shared library, with the alias GRANUMAT
include(${CMAKE_CURRENT_LIST_DIR}/granumat-targets.cmake)
