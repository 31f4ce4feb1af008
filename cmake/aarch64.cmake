# For 64-bit ARM, with Debian's cross compiler and a folder that holds Debian's packages for it: `make aarch64`.
set(ROOT "$ENV{AMRPIC_ARM64_ROOT}")
set(LIBRARIES "${ROOT}/usr/lib/aarch64-linux-gnu")

set(CMAKE_SYSTEM_NAME Linux)
set(CMAKE_SYSTEM_PROCESSOR aarch64)
set(CMAKE_C_COMPILER aarch64-linux-gnu-gcc)
set(CMAKE_CXX_COMPILER aarch64-linux-gnu-g++)
set(CMAKE_LIBRARY_ARCHITECTURE aarch64-linux-gnu)
set(CMAKE_FIND_ROOT_PATH "${ROOT}")
set(CMAKE_FIND_ROOT_PATH_MODE_PROGRAM NEVER)
set(CMAKE_FIND_ROOT_PATH_MODE_LIBRARY ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_INCLUDE ONLY)
set(CMAKE_TRY_COMPILE_TARGET_TYPE STATIC_LIBRARY)

set(CMAKE_C_FLAGS_INIT "-idirafter ${ROOT}/usr/include")  # behind the cross compiler's own
set(CMAKE_CXX_FLAGS_INIT "${CMAKE_C_FLAGS_INIT}")
set(CMAKE_MODULE_LINKER_FLAGS_INIT "-Wl,-rpath-link,${LIBRARIES} -Wl,--allow-shlib-undefined")

set(Python_INCLUDE_DIR "${ROOT}/usr/include/python3.11")
set(PKG_CONFIG_EXECUTABLE FALSE)  # it knows this machine alone
set(MPI_SKIP_COMPILER_WRAPPER ON)
set(MPI_C_LIB_NAMES mpi)
set(MPI_C_HEADER_DIR "${LIBRARIES}/openmpi/include")
set(MPI_mpi_LIBRARY "${LIBRARIES}/openmpi/lib/libmpi.so")
