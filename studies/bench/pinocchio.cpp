// The joint torque regressor of a serial arm by Pinocchio, sample by sample; the results of the last `kept` stay.
#include <cstring>
#include <pinocchio/algorithm/regressor.hpp>

extern "C" void run(long n, long kept, long joints, double gravity, const double *places, const double *q,
                    const double *qd, const double *qdd, double *out)
{
    pinocchio::Model model;
    model.gravity.linear(Eigen::Vector3d(0, 0, -gravity));
    for (long k = 0; k < joints; k++) {
        const Eigen::Matrix4d place = Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(places + 16 * k);
        model.addJoint(k, pinocchio::JointModelRZ(), pinocchio::SE3(place), std::to_string(k));
    }
    pinocchio::Data data(model);
    using Vector = Eigen::Map<const Eigen::VectorXd>;
    for (long s = 0; s < n; s++) {
        pinocchio::computeJointTorqueRegressor(model, data, Vector(q + joints * s, joints),
                                               Vector(qd + joints * s, joints), Vector(qdd + joints * s, joints));
        const auto &found = data.jointTorqueRegressor;
        std::memcpy(out + found.size() * (s % kept), found.data(), found.size() * sizeof(double));
    }
}
