"""The comparison of algorithms: which light each shows, and how fast its error falls.

* `steps`: the integrators of the ladder, from ray casting to path tracing, and what each leaves out.
* `measure`: time, RMSE, bias and error floor of each against a reference.
* `page`: the results as one HTML file; `curves` and `pictures` are its parts.
* `strips`: pictures of the bounces, and of increasing numbers of samples.

    from djpt.validation.integrator_comparison.measure import measure
    from djpt.validation.integrator_comparison.page import html

    Path("ladder.html").write_text(html(measure("cornell_box", seconds=5)), encoding="utf-8")
"""
