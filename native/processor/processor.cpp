// Which instruction sets this processor has, of those that kernels are built for. A module of its own, which runs on
// any.
#include <Python.h>

namespace {

#if defined(__x86_64__)
bool has(int level) {
  __builtin_cpu_init();
  // The levels of the x86-64 psABI. The operating system's part, that it keeps the wide registers, is in these too.
  switch (level) {
    case 2:
      return __builtin_cpu_supports("x86-64-v2");
    case 3:
      return __builtin_cpu_supports("x86-64-v3");
    default:
      return __builtin_cpu_supports("x86-64-v4");
  }
}
#else
bool has(int) { return false; }
#endif

PyObject* sets(PyObject*, PyObject*) {
  PyObject* const out = PyList_New(0);
  if (!out) return nullptr;
  for (int level = 4; level >= 2; --level) {
    if (!has(level)) continue;
    PyObject* const name = PyUnicode_FromFormat("v%d", level);
    int const failed = name ? PyList_Append(out, name) : -1;
    Py_XDECREF(name);
    if (failed) {
      Py_DECREF(out);
      return nullptr;
    }
  }
  return out;
}

PyMethodDef methods[] = {
    {"sets", sets, METH_NOARGS, "Those of the x86-64 instruction sets v4, v3, v2 that this processor has, best first."},
    {nullptr, nullptr, 0, nullptr}};

PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_processor", "The processor.", -1, methods, nullptr, nullptr, nullptr, nullptr};

}  // namespace

PyMODINIT_FUNC PyInit__processor() { return PyModule_Create(&definition); }
