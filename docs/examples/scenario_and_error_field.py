"""Run a scenario from Python and draw its error field: the largest error over the headings at each test position.

Needs pandas, which `pip install pandas` brings.
"""

import matplotlib.pyplot as plt

import deepgps

run = deepgps.simulate("tiny", methods=["deepgps", "knn"], settings={"encoder.step_noise": 0.05})
figure, axes = plt.subplots(1, len(run.methods), figsize=(10, 4), sharex=True, sharey=True, layout="constrained")
for name, each in zip(run.methods, axes, strict=True):
    errors = run.errors(name).to_pandas()
    worst = errors.loc[errors.groupby(["x_m", "y_m"])["error_m"].idxmax()]
    arrows = each.quiver(
        worst.x_m,
        worst.y_m,
        worst.predicted_x_m - worst.x_m,
        worst.predicted_y_m - worst.y_m,
        100 * worst.error_m,
        angles="xy",
        scale_units="xy",
        scale=1,
    )
    each.set(title=f"{name}: {100 * run.metrics['methods'][name]['rms_m']:.1f} cm RMS", aspect="equal", xlabel="x [m]")
    figure.colorbar(arrows, ax=each, label="error [cm]")
axes[0].set_ylabel("y [m]")
figure.savefig("error_field.png", dpi=120)
print(f"{run.folder}: see error_field.png")
