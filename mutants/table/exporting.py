"""Of how a policy leaves for the robot. See `mutants.table`."""

from mutants.mutation import Table

_MEANS = "exporting/test_exporting.py::test_operations_mean_what_jaxs_do"
_LEAVES = "exporting/test_exporting.py::test_numpy_alone_acts_as_jax_does"

TABLE: Table = {
    "guider/exporting/program.py": [
        ("which, cases[1], cases[0])", "which, cases[0], cases[1])", _MEANS),
        ("order.append(len(at) + others.index", "order.insert(0, len(at) + others.index", _MEANS),
        ("order = [*places, *others]", "order = [*others, *places]", _MEANS),
        ("shape[axis] = 1\n", "shape[axis] = 2\n", _MEANS),
        ("''.join(batch + rest)", "''.join(rest + batch)", _MEANS),
        ("needed.update(node.inputs)", "needed.update(node.inputs[:1])", _MEANS),
    ],
    "guider/exporting/controller.py": [
        ("acting, begins[None])", "acting, ~begins[None])", _LEAVES),
    ],
    "guider/exporting/actor.py": [
        ("self._begins, self.subgoal = np.array(False)", "self._begins, self.subgoal = np.array(True)", _LEAVES),
        ('results[f"next_{name}"] for name', "self._first[name] for name", _LEAVES),
    ],
}
