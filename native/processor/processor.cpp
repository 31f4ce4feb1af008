// Which instruction sets this processor has, of those that kernels are built for. A module of its own, which runs on
// any.
#include <Python.h>

#include "processor/levels.hpp"

namespace {

PyObject* sets(PyObject*, PyObject*) {
  PyObject* const out = PyList_New(0);
  if (!out) return nullptr;
  bool const complete = amrpic::for_each_level([out](int level) {
    PyObject* const name = PyUnicode_FromFormat("v%d", level);
    int const failed = name ? PyList_Append(out, name) : -1;
    Py_XDECREF(name);
    return failed == 0;
  });
  if (complete) return out;
  Py_DECREF(out);
  return nullptr;
}

PyObject* slowed_by_wide_vectors(PyObject*, PyObject*) { return PyBool_FromLong(amrpic::slowed_by_wide_vectors()); }

PyMethodDef methods[] = {
    {"sets", sets, METH_NOARGS,
     "Those of the x86-64 instruction sets v4, v3, v2 that this processor has, fastest first."},
    {"slowed_by_wide_vectors", slowed_by_wide_vectors, METH_NOARGS, "Whether v4 is no faster than v3 here."},
    {nullptr, nullptr, 0, nullptr}};

PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_processor", "The processor.", -1, methods, nullptr, nullptr, nullptr, nullptr};

}  // namespace

PyMODINIT_FUNC PyInit__processor() { return PyModule_Create(&definition); }
