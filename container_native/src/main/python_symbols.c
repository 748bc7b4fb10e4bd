/* Only for ROS from PyPI's wheels.
 *
 * librcl of the wheels is linked against the Python halves of its interface packages
 * (lib*__rosidl_generator_py.so), which want these two data symbols from libpython. The dynamic
 * loader resolves data symbols at once, so a program that is not Python would not start. Nothing
 * ever touches them: the Python halves are only called from Python, and their function symbols are
 * resolved lazily. The program must export them (-rdynamic).
 */

void* PyExc_RuntimeError;
char _Py_TrueStruct[64];
