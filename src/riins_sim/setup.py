from setuptools import find_packages, setup

NAME = "riins_sim"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={"": ["py.typed", "*.html", "*.css", "*.j2"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        # not entry points: those import for 30 ms before a signal can be taken
        (f"lib/{NAME}", [f"scripts/{node}" for node in ("rimu", "gps", "bds", "doppler", "odometer", "altimeter", "star_tracker", "truth")]),
    ],
    install_requires=["setuptools"],
    zip_safe=False,
    maintainer="RIINS developers",
    maintainer_email="riins@example.org",
    description="The simulated ship, car or aircraft: scenario, trajectory, waves, redundant IMU, its aids, faults; one node each.",
    license="Apache-2.0",
    extras_require={"test": ["pytest"]},
)
