# Repairs include directories that the PyPI wheels of ROS 2 carry from the machine they were built on.
#
# Passed as -DCMAKE_PROJECT_INCLUDE=<this file>. At the end of the configuration it walks the imported targets and puts this
# Python's own include directories in place of those below /opt/python/. With an apt installation of ROS 2 it changes nothing.

function(riins_repair_imported_targets)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  set(replacement ${Python3_INCLUDE_DIRS} ${Python3_NumPy_INCLUDE_DIRS})
  foreach(target IN LISTS targets)
    get_target_property(directories ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(NOT directories)
      continue()
    endif()
    set(repaired "")
    set(changed FALSE)
    foreach(directory IN LISTS directories)
      if(directory MATCHES "^/opt/python/")
        set(changed TRUE)
        list(APPEND repaired ${replacement})
      else()
        list(APPEND repaired "${directory}")
      endif()
    endforeach()
    if(changed)
      list(REMOVE_DUPLICATES repaired)
      set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${repaired}")
    endif()
  endforeach()
endfunction()

cmake_language(DEFER CALL riins_repair_imported_targets)
