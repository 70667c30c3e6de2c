from setuptools import find_packages, setup

NAME = "riins_nmea"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={"": ["py.typed", "*.html", "*.css", "*.j2"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        # not entry points: those import for 30 ms before a signal can be taken
        (f"lib/{NAME}", ["scripts/nmea", "scripts/motion"]),
    ],
    install_requires=["setuptools"],
    zip_safe=False,
    maintainer="RIINS developers",
    maintainer_email="riins@example.org",
    description="NMEA 0183 for the bridge, out and in; heave and attitude at the IMU rate.",
    license="Apache-2.0",
    extras_require={"test": ["pytest"]},
)
