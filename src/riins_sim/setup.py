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
    ],
    install_requires=["setuptools"],
    zip_safe=False,
    maintainer="RIINS developers",
    maintainer_email="riins@example.org",
    description="The simulated ship: scenario, trajectory, waves, redundant IMU, GPS, BDS, Doppler log, faults; one node each.",
    license="Apache-2.0",
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": [
            "rimu = riins_sim.nodes.rimu:main",
            "gps = riins_sim.nodes.gps:main",
            "bds = riins_sim.nodes.bds:main",
            "doppler = riins_sim.nodes.doppler:main",
            "truth = riins_sim.nodes.truth:main",
        ],
    },
)
